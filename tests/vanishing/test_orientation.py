"""Gabor filters, and the orientation of texture."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.vanishing.orientation import (
    OCTAVES,
    GaborBank,
    dominant_orientation,
    filter_spectrum,
    gabor_responses,
)
from roadtorch.vanishing.voting import angle_between


def stripes(angle: float, wavelength: float = 6.0, size: int = 64) -> Tensor:
    """Grey (size,size) in [0,1], its stripes running at an angle in degrees."""
    row, column = torch.meshgrid(torch.arange(size), torch.arange(size), indexing="ij")
    turn = math.radians(angle)
    across = row * math.cos(turn) - column * math.sin(turn)
    return 0.5 + 0.5 * (2 * math.pi * across / wavelength).cos()


@pytest.mark.parametrize("angle", [0, 20, 45, 90, 130, 175])
def test_stripes_run_the_way_they_run(angle: float) -> None:
    found, sure = dominant_orientation(gabor_responses(stripes(angle), GaborBank()))

    inside = found[16:48, 16:48]
    assert (angle_between(inside, torch.tensor(float(angle))) <= 5).all()
    assert sure.shape == (64, 64)


def test_the_spectrum_is_that_of_the_filter_as_it_is_written() -> None:
    # Kong et al., pixel by pixel, and its discrete Fourier transform.
    size, angle, frequency = 96, 30.0, 0.7
    place = np.arange(size) - size // 2
    y, x = np.meshgrid(place, place, indexing="ij")
    turn = math.radians(angle)
    a, b = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    envelope = np.exp(-(frequency**2) * (4 * a**2 + b**2) / (8 * OCTAVES**2))
    wave = np.exp(1j * frequency * a) - math.exp(-(OCTAVES**2) / 2)
    filtered = frequency / (math.sqrt(2 * math.pi) * OCTAVES) * envelope * wave

    expected = np.fft.fft2(np.fft.ifftshift(filtered))

    found = filter_spectrum((size, size), angle, frequency).numpy()
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_confidence_is_one_less_the_middle_responses_over_the_greatest() -> None:
    responses = torch.linspace(1, 2, 36)[:, None, None].repeat(1, 1, 2)
    responses[:35, 0, 1] = 0.1  # one response stands out

    angle, sure = dominant_orientation(responses)

    assert angle.tolist() == [[175.0, 175.0]]
    assert sure.tolist() == [[0.0, 1.0]]  # scaled to the picture


def test_where_there_is_no_texture_nothing_is_sure() -> None:
    _, sure = dominant_orientation(gabor_responses(torch.full((20, 30), 0.3), GaborBank()))

    assert not sure.any()
