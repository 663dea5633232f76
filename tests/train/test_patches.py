"""Patches: jitter, noise, all of a picture in one pass."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.layout.reflection import reflected
from roadtorch.train.config import Jitter
from roadtorch.train.patches import Draw, add_noise, cut_patches, draw_jitter, draw_noise
from tests.reference import network as reference


def drawn(centre: Tensor, scale: float = 1.0, turn: float = 0.0, noise: float = 0.0) -> Draw:
    each = torch.ones(len(centre))
    return Draw(centre.float(), each * scale, each * turn, each * noise, torch.arange(len(centre)))


def test_without_jitter_a_patch_is_what_the_network_sees_at_that_pixel() -> None:
    pixels = torch.randn(3, 20, 24, generator=torch.Generator().manual_seed(1))
    centres = torch.tensor([[0, 0], [19, 23], [7, 12]])

    patches = cut_patches(pixels, drawn(centres), 32)

    framed = reflected(pixels, 32)
    wanted = [framed[:, r : r + 32, c : c + 32] for r, c in centres.tolist()]
    torch.testing.assert_close(patches, torch.stack(wanted), atol=1e-4, rtol=0)


@settings(max_examples=15)
@given(st.floats(0.6, 1.4), st.floats(-17, 17), st.integers(0, 17), st.integers(0, 22))
def test_jittered_patches_equal_those_cut_pixel_by_pixel(
    scale: float, degrees: float, row: int, column: int
) -> None:
    pixels = torch.rand(3, 18, 23, generator=torch.Generator().manual_seed(2))
    turn = math.radians(degrees)
    centre = torch.tensor([[row, column]])

    patch = cut_patches(pixels, drawn(centre, scale, turn), 12)[0]

    wanted = reference.jittered_patch(pixels.double().numpy(), row, column, 12, scale, turn)
    np.testing.assert_allclose(patch.numpy(), wanted, atol=2e-4)


def test_magnification_makes_things_larger() -> None:
    pixels = torch.zeros(3, 41, 41)
    pixels[:, 18:23, 18:23] = 1
    centre = torch.tensor([[20, 20]])

    small, large = (cut_patches(pixels, drawn(centre, s), 32).sum() for s in (0.6, 1.4))

    assert small < pixels.sum() < large


def test_jitter_stays_within_its_bounds_and_fills_them() -> None:
    draw = draw_jitter(torch.zeros(4000, 2), Jitter(), torch.Generator().manual_seed(0))

    for values, low, high in [
        (draw.scale, 0.6, 1.4),
        (draw.turn, -math.radians(17), math.radians(17)),
        (draw.noise, 0.3, 1.2),
    ]:
        assert low <= float(values.min()) < low + 0.01 * (high - low)
        assert high >= float(values.max()) > high - 0.01 * (high - low)


def test_noise_is_in_grey_levels_of_255_whatever_the_gain() -> None:
    generator = torch.Generator().manual_seed(5)
    draw = draw_jitter(torch.zeros(300, 2), Jitter(faintest=0.8, noisiest=0.8), generator)

    noise = add_noise(torch.zeros(300, 3, 32, 32), draw, draw_noise(32, generator), gain=4.0)

    assert float(noise.std()) * 255 / 4 == pytest.approx(0.8, rel=0.01)
    assert abs(float(noise.mean())) < 1e-3
    assert not torch.equal(noise[0], noise[1])
