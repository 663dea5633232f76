"""Where samples of road come from: the area, its superpixels, and the distinct colours."""

import pytest
import torch
from torch import Tensor

from roadtorch.imaging.color import PLANES, REPRESENTATIONS, planes
from roadtorch.oneclass.samples import (
    AllSampleSettings,
    SampleSettings,
    WideSeedArea,
    area_segments,
    colours,
    representation,
    road_samples,
    sample_area,
)
from roadtorch.superpixels.segments import segment_median
from tests.streets import scene

GRID = SampleSettings(reduction="grid")


def eight_bit(height: int = 96, width: int = 128, levels: int = 12) -> Tensor:
    """A picture of few colours, as read_image gives it."""
    generator = torch.Generator().manual_seed(0)
    bytes_ = torch.randint(levels, (3, height, width), generator=generator, dtype=torch.uint8)
    return (bytes_ * (255 // levels)).to(torch.float32).div_(255)


# --- the area ---------------------------------------------------------------------------------


def test_the_area_of_p3_has_13266_pixels() -> None:
    rows, columns = sample_area((480, 640))

    assert (rows, columns) == (slice(414, 480), slice(219, 420))
    image = torch.rand(3, 480, 640)
    assert road_samples(image, ("R", "G"), AllSampleSettings()).shape == (13_266, 2)


@pytest.mark.parametrize(
    ("size", "shape"),
    [
        ((360, 480), (50, 151)),
        ((16, 16), (8, 8)),
        ((1080, 1920), (148, 603)),
        ((16, 400), (8, 126)),
    ],
)
def test_the_area_scales_with_the_picture_and_stays_inside(
    size: tuple[int, int], shape: tuple[int, int]
) -> None:
    rows, columns = sample_area(size)

    assert (rows.stop - rows.start, columns.stop - columns.start) == shape
    assert rows.stop == size[0]
    left, right = columns.start, size[1] - columns.stop
    assert 0 <= right - left <= 1


# --- distinct colours -----------------------------------------------------------------------------


def test_distinct_colours_are_the_pictures_own_to_the_bit() -> None:
    image = eight_bit()

    found = colours(image)

    assert found.values.shape[1] < 12**3 + 1
    assert torch.equal(found.values[:, found.index], image)
    assert len(found.values.unique(dim=1).T) == found.values.shape[1]


def test_a_picture_without_levels_keeps_all_of_its_pixels() -> None:
    image = torch.rand(3, 20, 30, generator=torch.Generator().manual_seed(0))

    found = colours(image)

    assert found.values.shape == (3, 600)
    assert torch.equal(found.values[:, found.index], image)


@pytest.mark.parametrize("names", REPRESENTATIONS.values(), ids=REPRESENTATIONS.keys())
def test_a_representation_is_its_planes(names: tuple[str, ...]) -> None:
    for image in (eight_bit(), eight_bit() * 0.99):  # with levels and without
        found = representation(image, names)

        torch.testing.assert_close(found.values[:, found.index], planes(image, names))


# --- samples ------------------------------------------------------------------------------------


def test_about_ninety_superpixels_give_about_ninety_samples() -> None:
    image = scene(3, 240, 320).image

    samples = road_samples(image, ("R", "G", "B"), SampleSettings())

    assert 60 <= len(samples) <= 130
    assert samples.shape[1] == 3


def test_a_sample_is_the_median_of_its_superpixel() -> None:
    image, settings = scene(3, 240, 320).image, SampleSettings()
    rows, columns = sample_area((240, 320))

    found = road_samples(image, ("S", "O2"), settings)

    labels = area_segments(image, settings, WideSeedArea())
    stack = planes(image, ("S", "O2"))[:, rows, columns]
    expected = segment_median(stack, labels, int(labels.max()) + 1)
    torch.testing.assert_close(found, expected.T, atol=1e-6, rtol=0)


def test_the_grid_is_of_six_by_fifteen_cells() -> None:
    labels = area_segments(torch.rand(3, 480, 640), GRID, WideSeedArea())

    assert labels.shape == (66, 201)
    assert torch.bincount(labels.flatten()).shape == (90,)
    assert labels[0].unique().numel() == 15
    assert torch.bincount(labels.flatten()).min() > 100


@pytest.mark.parametrize("reduction", ["grid", "superpixels", "none"])
@pytest.mark.parametrize("size", [(16, 16), (16, 300), (200, 17)])
def test_small_areas_have_samples(reduction: str, size: tuple[int, int]) -> None:
    settings = SampleSettings.model_validate({"reduction": reduction})
    image = 0.2 + 0.5 * torch.rand(3, *size, generator=torch.Generator().manual_seed(1))

    samples = road_samples(image, ("R", "G", "B"), settings)

    assert len(samples) >= 8
    assert samples.min() > 0.19  # no segment is empty


@pytest.mark.parametrize("settings", [SampleSettings(), GRID], ids=["superpixels", "grid"])
def test_medians_of_hue_follow_the_circle(settings: SampleSettings) -> None:
    image = eight_bit() * 0
    image[0], image[1:] = 0.8, 0.4
    image[1, :, ::2] += 0.01  # hue just above and just below red
    image[2, :, 1::2] += 0.01

    hue = road_samples(image, ("H",), settings)[:, 0]

    assert torch.minimum(hue, 1 - hue).max() < 0.01


@pytest.mark.parametrize("names", [("R", "G", "B"), ("H", "S"), ("nr",)])
def test_medoids_are_pixels_of_the_area_near_the_medians(names: tuple[str, ...]) -> None:
    image = scene(3, 240, 320).image
    settings = SampleSettings(central="medoid")

    medoids = road_samples(image, names, settings)

    pixels = road_samples(image, names, AllSampleSettings())
    medians = road_samples(image, names, SampleSettings())
    assert all(bool((pixels == medoid).all(1).any()) for medoid in medoids)
    assert medoids.shape == medians.shape
    away = (medoids - medians).abs()
    turns = torch.tensor([PLANES[name].circular for name in names])
    assert torch.where(turns, torch.minimum(away, 1 - away), away).median() < 0.05
