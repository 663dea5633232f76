"""Samples of road: the seed area, its superpixels, and the distinct colours."""

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.imaging.color import REPRESENTATIONS, color_planes
from roadtorch.imaging.segments import segment_median
from roadtorch.oneclass.samples import (
    SampleSettings,
    WideSeedArea,
    area_segments,
    distinct_colours,
    representation,
    road_samples,
    sample_area,
)
from tests.draws import random, seeded_generator
from tests.streets import scene


def eight_bit(levels: int = 12) -> Tensor:
    """Return an 8-bit image of few colours, as read_image does."""
    steps = torch.randint(levels, (3, 96, 128), generator=seeded_generator(), dtype=torch.uint8)
    return (steps * (255 // levels)).to(torch.float32).div_(255)


# --- the area ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "shape"),
    [
        ((480, 640), (66, 201)),  # P3's 13,266 pixels
        ((16, 16), (8, 8)),
        ((1080, 1920), (148, 603)),
    ],
)
def test_the_area_scales_with_the_image(size: tuple[int, int], shape: tuple[int, int]) -> None:
    rows, columns = sample_area(size)

    assert (rows.stop - rows.start, columns.stop - columns.start) == shape
    assert rows.stop == size[0]
    assert 0 <= size[1] - columns.stop - columns.start <= 1


# --- distinct colours -----------------------------------------------------------------------------


def test_distinct_colours_are_bit_identical_to_the_image() -> None:
    for image in (eight_bit(), random(3, 20, 30, dtype=torch.float32)):
        palette = distinct_colours(image)

        assert torch.equal(palette.values[:, palette.indices], image)
        assert palette.values.unique(dim=1).shape == palette.values.shape
        assert palette.values.shape[1] <= 12**3


@pytest.mark.parametrize("names", REPRESENTATIONS.values(), ids=REPRESENTATIONS.keys())
def test_a_representation_is_its_planes(names: tuple[str, ...]) -> None:
    for image in (eight_bit(), eight_bit() * 0.99):  # with levels and without
        palette = representation(image, names)

        expected = color_planes(image, names)
        np.testing.assert_allclose(
            palette.values[:, palette.indices], expected, rtol=1e-6, atol=1e-6
        )


# --- samples ------------------------------------------------------------------------------------


def test_a_sample_is_the_median_of_one_of_about_ninety_superpixels() -> None:
    image, settings = scene(3, 240, 320).image, SampleSettings()
    rows, columns = sample_area((240, 320))

    samples = road_samples(image, ("S", "O2"), settings)

    labels = area_segments(image, settings, WideSeedArea())
    stack = color_planes(image, ("S", "O2"))[:, rows, columns]
    expected = segment_median(stack, labels, int(labels.max()) + 1)
    assert 60 <= len(samples) <= 130
    np.testing.assert_allclose(samples, expected.T, atol=1e-6)


def test_medians_of_hue_follow_the_circle() -> None:
    image = eight_bit() * 0
    image[0], image[1:] = 0.8, 0.4
    image[1, :, ::2] += 0.01  # hue just above and just below red
    image[2, :, 1::2] += 0.01

    hue = road_samples(image, ("H",), SampleSettings())[:, 0]

    assert torch.minimum(hue, 1 - hue).max() < 0.01
