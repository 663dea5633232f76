"""Colour plane fusion and uniformity, against their equations and slow twins."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.feature import local_binary_pattern

from roadtorch.imaging.color import planes
from roadtorch.road.texture import (
    TextureSettings,
    fused_plane,
    minimum_variance_weights,
    quantise,
    saturated,
    similarity,
    smallest_patterns,
    uniform_patterns,
    uniformity,
    uniformity_likelihood,
    value_range,
)
from tests.draws import random
from tests.reference import texture as reference


def correlated_samples(count: int = 400, planes: int = 4, seed: int = 0) -> torch.Tensor:
    """Samples (count, planes) with correlated planes of different variance."""
    return random(count, planes, seed=seed) @ (random(planes, planes, seed=seed + 1) - 0.3)


# Weights (P2 eq. 3)


def test_weights_follow_equation_3():
    samples = correlated_samples()

    weights = minimum_variance_weights(samples, ridge=0)

    expected = reference.minimum_variance_weights(samples.numpy())
    np.testing.assert_allclose(weights.numpy(), expected, rtol=1e-6)


def test_without_a_ridge_the_nine_planes_of_the_paper_fuse_to_nothing():
    image = random(3, 24, 32, dtype=torch.float32)
    stack = planes(image, TextureSettings().planes)
    samples = stack[:, 16:].flatten(1).T

    collapsed, kept = (
        fused_plane(stack, minimum_variance_weights(samples, ridge)) for ridge in (0.0, 3e-3)
    )

    # (R - G - √2·O1) / -√2 has weights that sum to 1, and is 0 in every picture.
    assert collapsed.std() < 1e-3
    assert kept.std() > 10 * collapsed.std()


@pytest.mark.parametrize("ridge", [0, 1e-8, 1e-3, 1, 1e6])
@pytest.mark.parametrize("count", [1, 2, 5, 2400])
def test_weights_sum_to_one_even_with_fewer_samples_than_planes(ridge, count):
    weights = minimum_variance_weights(correlated_samples(count, 9), ridge)

    assert weights.sum().item() == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("level", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_constant_area_weighs_all_planes_alike(level, dtype):
    samples = torch.full((2400, 9), level, dtype=dtype)

    weights = minimum_variance_weights(samples, ridge=0.001)

    assert weights.dtype == dtype
    assert weights.tolist() == pytest.approx([1 / 9] * 9, abs=1e-4)


def test_a_large_ridge_gives_the_mean_of_the_planes():
    weights = minimum_variance_weights(correlated_samples(), ridge=1e6)

    assert weights.tolist() == pytest.approx([0.25] * 4, abs=1e-4)


def test_the_ridge_is_relative_so_that_contrast_does_not_matter():
    samples = correlated_samples()

    weights = minimum_variance_weights(samples, ridge=0.01)

    torch.testing.assert_close(minimum_variance_weights(7 * samples, 0.01), weights)


# Fused plane (P2 eq. 2)


def test_the_fused_plane_is_the_weighted_sum():
    planes, weights = random(3, 4, 5), torch.tensor([0.5, -1.0, 1.5], dtype=torch.float64)

    fused = fused_plane(planes, weights)

    np.testing.assert_allclose(fused, reference.fused(planes.numpy(), weights.numpy()))


# Levels


def test_levels_are_equal_steps_and_the_ends_take_what_lies_beyond():
    values = torch.tensor([-9.0, 0.0, 0.24, 0.25, 0.6, 1.0, 9.0])

    levels = quantise(values, 4, 0, 1)

    assert levels.dtype == torch.int64
    assert levels.tolist() == [0, 0, 0, 1, 2, 3, 3]


@pytest.mark.parametrize("value", [-3.0, 0.0, 2.0])
def test_an_empty_range_still_gives_valid_levels(value):
    levels = quantise(torch.full((2, 2), value), 8, value, value)

    assert levels.unique().tolist() == [0]


def test_rounding_errors_are_no_texture():
    flat = 0.3 + 1e-7 * random(20, 20, dtype=torch.float32)

    levels = quantise(flat, 64, float(flat.min()), float(flat.max()))

    assert levels.unique().tolist() == [0]


def test_the_range_skips_the_tails_of_the_usable_pixels():
    plane = torch.arange(1000.0).reshape(20, 50)
    usable = plane < 500

    assert value_range(plane, usable, 0) == (0, 499)
    assert value_range(plane, usable, 0.01) == (5, 494)


def test_the_range_of_one_or_no_usable_pixel_is_defined():
    plane = torch.tensor([[3.0, 4.0]])

    assert value_range(plane, torch.tensor([[False, True]]), 0.4) == (4, 4)
    assert value_range(plane, torch.tensor([[False, False]]), 0.4) == (0, 1)


# Uniformity (P2 eq. 1)


@given(st.lists(st.integers(0, 7), min_size=1, max_size=60))
def test_uniformity_follows_equation_1(levels):
    histogram = torch.bincount(torch.tensor(levels), minlength=8).float()

    expected = reference.uniformity_of_values(np.array(levels))
    assert uniformity(histogram).item() == pytest.approx(expected, abs=1e-6)


def test_uniformity_is_one_for_one_level_least_for_an_even_histogram_zero_for_none():
    histograms = torch.tensor([[0.0, 9.0, 0.0, 0.0], [5.0, 5.0, 5.0, 5.0], [0.0, 0.0, 0.0, 0.0]])

    assert uniformity(histograms).tolist() == [1, 0.25, 0]


def test_the_likelihood_of_uniformity_grows_and_is_one_half_at_the_given_value():
    values = torch.linspace(0, 1, 101)

    likelihood = uniformity_likelihood(values, 0.3)

    assert (likelihood.diff() > 0).all()
    assert likelihood[0] == 0
    assert likelihood[30].item() == pytest.approx(0.5)
    assert likelihood[-1] <= 1


# Saturation (CPFv2)


def test_a_pixel_is_saturated_when_one_channel_is_full_or_all_are_black():
    pixels = {
        "white": (1.0, 1.0, 1.0),
        "one full": (0.99, 0.2, 0.1),
        "black": (0.01, 0.0, 0.01),
        "dark blue": (0.0, 0.0, 0.2),
        "grey": (0.5, 0.5, 0.5),
    }
    image = torch.tensor(list(pixels.values())).T[:, None]

    found = saturated(image, dark=0.02, bright=0.98)

    assert dict(zip(pixels, found[0].tolist(), strict=True)) == {
        "white": True,
        "one full": True,
        "black": True,
        "dark blue": False,
        "grey": False,
    }


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


@pytest.mark.parametrize("level", [0.0, 0.1, 0.3, 1 / 3, 0.7])
def test_every_neighbour_in_a_flat_picture_counts_as_bright(level):
    grey = torch.full((16, 16), level)

    assert (uniform_patterns(grey) == 8).all()
    assert (smallest_patterns(grey) == 255).all()


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
