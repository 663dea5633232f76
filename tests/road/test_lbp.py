"""Local binary patterns, and how alike their histograms are."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.feature import local_binary_pattern

from roadtorch.road.lbp import similarity, smallest_patterns, uniform_patterns
from tests.reference import texture as reference


def random(*size: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.rand(*size, generator=torch.Generator().manual_seed(seed), dtype=dtype)


# Local binary patterns


@pytest.mark.filterwarnings("ignore:Applying `local_binary_pattern` to floating-point")
@pytest.mark.parametrize(
    ("patterns", "method"),
    [(uniform_patterns, "uniform"), (smallest_patterns, "ror")],
)
@pytest.mark.parametrize("seed", range(3))
def test_patterns_agree_with_scikit_image_inside_the_edge(patterns, method, seed):
    grey = random(30, 41, seed=seed)

    found = patterns(grey)[1:-1, 1:-1].numpy()

    expected = local_binary_pattern(grey.numpy(), 8, 1, method)[1:-1, 1:-1]
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("patterns", [uniform_patterns, smallest_patterns])
def test_patterns_turn_with_the_picture(patterns):
    grey = random(20, 20)

    assert torch.equal(patterns(grey.rot90()), patterns(grey).rot90())


@pytest.mark.parametrize("patterns", [uniform_patterns, smallest_patterns])
@given(st.floats(0.25, 3), st.floats(-1, 1))
@settings(max_examples=20, deadline=None)
def test_patterns_do_not_depend_on_exposure(patterns, gain, offset):
    grey = random(12, 12)

    assert torch.equal(patterns(gain * grey + offset), patterns(grey))


@pytest.mark.parametrize("level", [0.0, 0.1, 0.3, 1 / 3, 0.7])
def test_every_neighbour_in_a_flat_picture_counts_as_bright(level):
    grey = torch.full((16, 16), level)

    assert (uniform_patterns(grey) == 8).all()
    assert (smallest_patterns(grey) == 255).all()


def test_there_are_thirty_six_rotation_invariant_patterns():
    assert len(smallest_patterns(random(200, 200)).unique()) == 36


# Comparing histograms


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 50)), min_size=2, max_size=12))
@settings(deadline=None)
def test_similarity_is_one_minus_half_chi_square(pairs):
    first, second = (np.array(side, dtype=float) + 0.5 for side in zip(*pairs, strict=True))

    found = similarity(torch.from_numpy(first), torch.from_numpy(second)).item()

    assert found == pytest.approx(1 - reference.chi_square(first, second) / 2, abs=1e-9)


def test_similarity_runs_from_nothing_in_common_to_alike_whatever_the_counts():
    histograms = torch.tensor([[0.0, 0.0, 3.0], [4.0, 12.0, 0.0], [0.0, 0.0, 0.0]])

    found = similarity(histograms, torch.tensor([1.0, 3.0, 0.0]))

    assert found.tolist() == [0, 1, 0]
