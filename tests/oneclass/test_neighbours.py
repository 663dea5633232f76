"""Nearest neighbour and minimum spanning tree against loops over samples and edges."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.oneclass import neighbours
from roadtorch.oneclass.base import ClassifierSettings
from roadtorch.oneclass.neighbours import MST, NN
from tests.draws import seeded
from tests.oneclass.cases import doubles, fitted, some
from tests.reference import oneclass_boundary as reference

# --- nearest neighbour ------------------------------------------------------------------


def test_near_pixels_keep_their_digits_far_from_the_origin():
    samples = torch.tensor([[0.9, 0.9, 0.9], [0.1, 0.1, 0.1]])
    pixels = samples[:1] + torch.tensor([[0, 0, 0], [3e-5, 0, 0], [6e-5, 0, 0]])
    expected = reference.nearest_distance(doubles(samples), doubles(pixels))
    np.testing.assert_allclose(fitted(NN, samples).distance(pixels), expected, rtol=1e-6, atol=0)


@pytest.mark.parametrize(
    ("values", "half"),
    [
        ([0.1, 0.2, 0.4, 0.8], 0.15),  # to the next sample: 0.1, 0.1, 0.2, 0.4
        ([0.1, 0.1, 0.4, 0.8], 0.15),  # 0, 0, 0.3, 0.4: a twin is a neighbour
    ],
)
def test_threshold_leaves_each_sample_out(values, half):
    learned = fitted(NN, torch.tensor(values)[:, None], ClassifierSettings(rejected=0.5))
    assert float(learned.threshold) == pytest.approx(half)


@settings(max_examples=20)
@given(st.integers(1, 3), st.integers(1, 20), st.integers(0, 1000))
def test_order_and_twins_of_samples_change_no_distance(dimensions, number, seed):
    samples, pixels = some(number, dimensions, seed), some(30, dimensions, seed + 1)
    order = torch.randperm(number, generator=seeded(seed))
    mixed = torch.cat([samples[order], samples[: number // 2]])
    for classifier in (NN, MST):
        plain, other = fitted(classifier, samples), fitted(classifier, mixed)
        assert torch.equal(plain.distance(pixels), other.distance(pixels))


# --- minimum spanning tree --------------------------------------------------------------


@pytest.mark.parametrize(("rejected", "length"), [(0.0, 0.4), (0.34, 0.2), (0.7, 0.1)])
def test_tree_threshold_is_a_length_of_an_edge(rejected, length):
    samples = torch.tensor([[0.1], [0.2], [0.4], [0.8]])
    learned = fitted(MST, samples, ClassifierSettings(rejected=rejected))
    assert float(learned.threshold) == pytest.approx(length)


@pytest.mark.parametrize("apart", [1e-9, 1e-7])
def test_samples_that_differ_by_rounding_alone_still_make_a_tree(apart: float) -> None:
    grey = torch.tensor([[0.5, 0.5], [0.5, 0.5 + apart], [0.5 + apart, 0.5]], dtype=torch.float64)

    near = neighbours.spanning_tree(grey)
    far = neighbours.spanning_tree(torch.cat([grey, grey[:1] + 0.3]))

    assert {frozenset(edge) for edge in near.tolist()} == {frozenset((0, 1)), frozenset((0, 2))}
    assert len(far) == 3


def test_equal_edges_give_the_same_tree_every_time():
    grid = torch.cartesian_prod(torch.arange(4.0), torch.arange(4.0)) / 10
    first, again = (fitted(MST, samples).distance(some(200, 2)) for samples in (grid, grid.flip(0)))
    assert torch.equal(first, again)
