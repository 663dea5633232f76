"""The road's appearance in one image: a discriminant, and its fusion with the network."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.road.appearance import (
    MAX_WEIGHT,
    RELATIVE_RIDGE,
    appearance_log_odds,
    appearance_planes,
    average_log_odds,
)
from tests.reference import appearance as reference


def sample_pixels(seed: int = 0, pixels: int = 400) -> tuple[Tensor, Tensor, Tensor]:
    """Features (4, N) of two classes, bool (N,) which is road, log odds (N,) that often err."""
    generator = torch.Generator().manual_seed(seed)
    is_road = torch.rand(pixels, generator=generator) < 0.4
    features = torch.randn(4, pixels, generator=generator)
    features[1] += 3 * is_road
    features[3] = 0.5 * features[1] + 100 * features[3] + 7
    log_odds = 3 * (2.0 * is_road - 1) + 3 * torch.randn(pixels, generator=generator)
    return features, is_road, log_odds


@given(seed=st.integers(0, 50), weight=st.floats(0, 3))
def test_discriminant_and_fusion_equal_the_reference(seed: int, weight: float) -> None:
    features, _, log_odds = sample_pixels(seed, pixels=120)
    inputs, odds = features.double().numpy(), log_odds.double().numpy()
    expected = reference.discriminant(inputs, odds, RELATIVE_RIDGE)

    appearance = appearance_log_odds(features, log_odds)
    fused = average_log_odds(log_odds, appearance, weight)

    np.testing.assert_allclose(appearance, expected, atol=2e-3)
    mean = reference.average(odds, expected, weight, MAX_WEIGHT)
    np.testing.assert_allclose(fused, mean, atol=2e-3)


@pytest.mark.parametrize("sign", [1, -1])
def test_an_image_of_one_class_keeps_the_networks_log_odds(sign: int) -> None:
    features, _, log_odds = sample_pixels()
    log_odds = sign * (log_odds.abs() + 1)

    assert torch.equal(appearance_log_odds(features, log_odds), log_odds)


def test_shadow_changes_brightness_and_neither_chromaticity_nor_ratio() -> None:
    colour = torch.tensor([0.6, 0.5, 0.4])[:, None, None]

    lit, shaded = appearance_planes(colour), appearance_planes(colour / 2)

    torch.testing.assert_close(lit[:3], shaded[:3], atol=1e-3, rtol=0)
    assert abs(lit[5] - shaded[5]) < 0.03
    assert lit[3] == pytest.approx(2 * float(shaded[3]), abs=1e-3)
