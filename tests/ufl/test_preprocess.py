"""Resizing, blur and brightness equalisation."""

import numpy as np
import pytest
import torch

from roadtorch.ufl import preprocess
from tests.draws import random
from tests.reference import ufl as reference


@pytest.mark.parametrize(
    ("height", "width", "size"),
    [
        (360, 480, (120, 160)),
        (375, 1242, (120, 397)),
        (16, 16, (120, 120)),
        (16, 4000, (120, 480)),
        (4000, 16, (120, 30)),
    ],
)
def test_the_papers_sizes_follow_from_the_shape(height: int, width: int, size: tuple) -> None:
    assert preprocess.WorkingShape().size(height, width) == size


@pytest.mark.parametrize(("sigma", "reach"), [(1.5, 3), (2.5, 5), (0.4, 1), (1.6, 4)])
def test_blur_is_the_gaussian_of_equation_1_in_a_window_that_follows_sigma(
    sigma: float, reach: int
) -> None:
    smoothing, image = preprocess.Smoothing(sigma=sigma), random(2, 9, 11)

    found = preprocess.blur(image, smoothing.sigma, smoothing.reach)

    assert smoothing.reach == reach
    expected = np.stack([reference.blurred(plane, sigma, reach) for plane in image.numpy()])
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_equalisation_does_not_see_how_bright_a_picture_is() -> None:
    image = 0.2 + 0.5 * random(3, 20, 24)

    bright, dark = (preprocess.equalised(image * gain, preprocess.Smoothing()) for gain in (1, 0.1))

    np.testing.assert_allclose(bright, dark, rtol=1e-7)


def test_black_stays_black_where_the_program_divides_0_by_0() -> None:
    image = 0.3 + 0.3 * random(3, 32, 32)
    image[:, 5:25, 5:25] = 0

    found = preprocess.equalised(image, preprocess.Smoothing())

    assert found.isfinite().all()
    assert (found[:, 12:18, 12:18] == 0).all()


@pytest.mark.parametrize("size", [(10, 15), (37, 61), (20, 60)])
def test_bicubic_keeps_flat_pictures_and_8_bits(size: tuple[int, int]) -> None:
    flat = torch.full((3, 20, 30), 77 / 255, dtype=torch.float64)

    assert preprocess.bicubic(flat, (20, 30)) is flat
    assert preprocess.bicubic(flat, size).unique().tolist() == [77 / 255]
    levels = preprocess.bicubic(random(3, 20, 30), size) * 255
    np.testing.assert_allclose(levels, levels.round(), atol=1e-9)


def test_bicubic_halves_with_the_stretched_cubic_kernel() -> None:
    # Keys' kernel (a = -1/2) at the distances 1/4, 3/4, 5/4, 7/4, both sides, each over 2.
    taps = np.array([-3, -9, 29, 111, 111, 29, -9, -3]) / 256
    image = (random(1, 1, 16).expand(3, 16, 16) * 255).round() / 255

    found = preprocess.bicubic(image, (8, 8))

    row = image[0, 0].numpy() * 255
    expected = np.floor(np.clip(row[3:11] @ taps, 0, 255) + 0.5)
    assert found[0, 4, 3] * 255 == pytest.approx(expected)
