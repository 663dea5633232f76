"""Colour plane fusion and uniformity, against their equations and slow twins."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.feature import local_binary_pattern

from roadtorch.imaging.color import color_planes
from roadtorch.road.texture import (
    TextureSettings,
    fused_plane,
    minimum_variance_weights,
    quantise_plane,
    saturation_mask,
    similarity,
    uniform_patterns,
    value_range,
)
from tests.draws import random
from tests.reference import texture as reference


def correlated_samples(count: int = 400, planes: int = 4, seed: int = 0) -> torch.Tensor:
    """Return samples (count, planes) with correlated planes of different variance."""
    return random(count, planes, seed=seed) @ (random(planes, planes, seed=seed + 1) - 0.3)


# --- weights and the fused plane (P2 eqs. 2 and 3) ------------------------------------------


@pytest.mark.parametrize("ridge", [0.0, 0.5])
def test_weights_and_the_fused_plane_follow_equations_2_and_3(ridge):
    samples, stack = correlated_samples(), random(4, 5, 6)

    weights = minimum_variance_weights(samples, ridge)

    expected = reference.minimum_variance_weights(samples.numpy(), ridge)
    np.testing.assert_allclose(weights.numpy(), expected, rtol=1e-6)
    fused = reference.fused(stack.numpy(), weights.numpy())
    np.testing.assert_allclose(fused_plane(stack, weights), fused)


@pytest.mark.parametrize("scale", [1, 255])
def test_the_nine_planes_of_the_paper_take_the_pseudo_inverse_at_any_scale(scale):
    image = random(3, 24, 32, dtype=torch.float32) * scale
    stack = color_planes(image, TextureSettings().planes)
    samples = stack[:, 16:].flatten(1).T

    weights = minimum_variance_weights(samples)

    literal = np.linalg.pinv(np.cov(samples.T.double().numpy(), bias=True), 1e-11).sum(0)
    np.testing.assert_allclose(weights, literal / literal.sum(), atol=1e-5)
    # (R - G - √2·O1) / -√2 is 0 in every image: an inverse of Σ would fuse the planes to it.
    null = torch.tensor([1, -1, 0, 0, 0, -(2**0.5), 0, 0, 0])
    assert (weights @ null).abs() < 1e-5
    assert fused_plane(stack, weights).std() > 1e-3 * scale**0.5


# --- levels -----------------------------------------------------------------------------------

FLAT = 0.3 + 1e-7 * random(20, 20, dtype=torch.float32)


@pytest.mark.parametrize(
    ("values", "bins", "low", "high", "levels"),
    [
        # Equal steps; the ends take what lies beyond.
        (torch.tensor([-9, 0, 0.24, 0.25, 0.6, 1, 9]), 4, 0, 1, [0, 0, 0, 1, 2, 3, 3]),
        *[(torch.full((4,), value), 8, value, value, [0] * 4) for value in (-3.0, 0.0, 2.0)],
        (FLAT, 64, float(FLAT.min()), float(FLAT.max()), [0] * 400),  # rounding is no texture
    ],
)
def test_levels_are_equal_steps(values, bins, low, high, levels):
    result = quantise_plane(values, bins, low, high)

    assert result.dtype == torch.int64
    assert result.flatten().tolist() == levels


def test_the_range_skips_the_tails_of_the_usable_pixels():
    plane, pair = torch.arange(1000.0).reshape(20, 50), torch.tensor([[3.0, 4.0]])

    assert value_range(plane, plane < 500, 0) == (0, 499)
    assert value_range(plane, plane < 500, 0.01) == (5, 494)
    assert value_range(pair, torch.tensor([[False, True]]), 0.4) == (4, 4)
    assert value_range(pair, torch.tensor([[False, False]]), 0.4) == (0, 1)


# --- uniformity (P2 eq. 1) --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pixel", "is_saturated"),
    [
        ((1.0, 1.0, 1.0), True),
        ((0.99, 0.2, 0.1), True),  # one channel is full
        ((0.01, 0.0, 0.01), True),
        ((0.0, 0.0, 0.2), False),
        ((0.5, 0.5, 0.5), False),
    ],
)
def test_a_pixel_is_saturated_when_one_channel_is_full_or_all_are_black(pixel, is_saturated):
    image = torch.tensor(pixel).view(3, 1, 1)

    assert saturation_mask(image, dark=0.02, bright=0.98).item() == is_saturated


# --- local binary patterns --------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:Applying `local_binary_pattern` to floating-point")
def test_patterns_are_those_of_scikit_image_and_turn_with_the_image():
    grey = random(30, 41)
    expected = local_binary_pattern(grey.numpy(), 8, 1, "uniform")[1:-1, 1:-1]

    assert np.array_equal(uniform_patterns(grey)[1:-1, 1:-1].numpy(), expected)
    assert torch.equal(uniform_patterns(grey.rot90()), uniform_patterns(grey).rot90())
    for level in (0.0, 0.1, 0.3, 1 / 3, 0.7):  # every neighbour counts as bright
        assert (uniform_patterns(torch.full((16, 16), level)) == 8).all()


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 50)), min_size=2, max_size=12))
@settings(deadline=None)
def test_similarity_is_one_minus_half_chi_square(pairs):
    first, second = (np.array(side, dtype=float) + 0.5 for side in zip(*pairs, strict=True))

    result = similarity(torch.from_numpy(first), torch.from_numpy(second)).item()

    assert result == pytest.approx(1 - reference.chi_square(first, second) / 2, abs=1e-9)
