"""Where the samples of road come from, and each value of an image only once (P3, section V).

What depends on the image alone is marked ``cached_per_image``: many classifiers that look at one
image make it once. The planes are those of the distinct colours, so that a sample and a
pixel of one colour have the same values to the bit.
"""

from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.image_cache import cached_per_image
from roadtorch.base.settings import Settings
from roadtorch.imaging.color import PLANES, plane
from roadtorch.imaging.segments import segment_median
from roadtorch.imaging.slic import slic
from roadtorch.oneclass.axes import circular_mean, unrolled
from roadtorch.road.seed_area import FRAME, SeedArea, seed_area

MIN_SIDE = 8
"""Pixels that the seed area has on each side, where the image has them: a few samples."""

GRID_SHAPE = 15 / 6
"""Columns over rows of the cells that stand in for superpixels: 6x15 for 90."""

ALIKE = 1e-3
"""Values this close to a whole level of 255 are taken for 8-bit values."""


class WideSeedArea(SeedArea):
    """P3's seed area, its "training area": 201×66 pixels, 13,266, of a frame of 640×480.

    P3 does not give the size of its images; this is that of the same authors' other papers.
    """

    height: float = Field(
        default=33, ge=1, le=FRAME[0], description="rows, of a frame of 240; scaled with the image"
    )
    width: float = Field(
        default=100.5,
        ge=1,
        le=FRAME[1],
        description="columns, of a frame of 320; scaled likewise",
    )


SEED = WideSeedArea()
"""P3's own."""


def sample_area(shape: Sequence[int], seed: SeedArea = SEED) -> tuple[slice, slice]:
    """Rows and columns of the seed area whose pixels are samples of road, of a shape (…,H,W)."""
    return seed_area(shape[-2], shape[-1], seed, MIN_SIDE)


Reduction = Annotated[
    Literal["superpixels", "grid", "none"],
    Field(
        description="one sample per superpixel of the seed area, per cell of a grid, or each pixel"
    ),
]


class SampleSettings(Settings):
    """How many samples are made of the seed area."""

    reduction: Reduction = "superpixels"
    segments: int = Field(
        default=90,
        ge=1,
        le=10**5,
        description="superpixels or cells to aim at; the paper: about 90",
    )


class AllSampleSettings(SampleSettings):
    """The same with every pixel of the seed area, as P3 has it for its histograms."""

    reduction: Reduction = "none"


class Palette(NamedTuple):
    """Values that occur in an image, and where: values (d,k), index int64 (H,W) into them."""

    values: Tensor
    index: Tensor


@cached_per_image
def colours(image: Tensor) -> Palette:
    """The distinct colours of an image (3,H,W), values (3,k), if it has 8-bit levels.

    Of any other image each pixel is a colour of its own.
    """
    size = image.shape[-2:]
    levels = (image * 255).round_()
    if bool(((image * 255 - levels).abs() > ALIKE).any()):
        return Palette(image.flatten(1), torch.arange(size.numel()).view(size))
    red, green, blue = levels.to(torch.int32).flatten(1)
    packed, index = (red * 65536 + green * 256 + blue).unique(return_inverse=True)
    levels = torch.stack([packed // 65536, packed // 256 % 256, packed % 256])
    return Palette(levels.to(image.dtype) / 255, index.view(size))


@cached_per_image
def plane_values(image: Tensor, name: str) -> Palette:
    """The distinct values of one plane of an image (3,H,W): values (1,k)."""
    palette = colours(image)
    values, index = plane(palette.values[:, None], name)[0].unique(return_inverse=True)
    return Palette(values[None], index[palette.index])


@cached_per_image
def colour_plane(image: Tensor, name: str) -> Tensor:
    """One plane of the distinct colours of an image (3,H,W): (k,)."""
    return plane(colours(image).values[:, None], name)[0]


def representation(image: Tensor, names: tuple[str, ...]) -> Palette:
    """The distinct values of one or several planes of an image (3,H,W): values (d,k)."""
    if len(names) == 1:
        return plane_values(image, names[0])
    return Palette(torch.stack([colour_plane(image, name) for name in names]), colours(image).index)


@cached_per_image
def area_segments(image: Tensor, settings: SampleSettings, seed: SeedArea) -> Tensor:
    """Labels int64 (h,w) of the seed area: superpixels, or cells of a grid."""
    rows, columns = sample_area(image.shape, seed)
    area = image[:, rows, columns]
    if settings.reduction == "superpixels":
        return slic(area, settings.segments)
    height, width = area.shape[-2:]
    down = min(height, max(1, round((settings.segments / GRID_SHAPE) ** 0.5)))
    across = min(width, max(1, round(settings.segments / down)))
    row, column = (torch.arange(n) * cells // n for n, cells in ((height, down), (width, across)))
    return row[:, None] * across + column


@cached_per_image
def area_values(image: Tensor, name: str, seed: SeedArea) -> Tensor:
    """One plane in the seed area of an image: (h,w)."""
    index = colours(image).index
    return colour_plane(image, name)[index[sample_area(index.shape, seed)]]


@cached_per_image
def segment_medians(image: Tensor, name: str, settings: SampleSettings, seed: SeedArea) -> Tensor:
    """The lower median of one plane in each superpixel of the seed area: (m,).

    Of hue the median along the circle, seen from the mean hue of the area.
    """
    values = area_values(image, name, seed)
    labels = area_segments(image, settings, seed)
    count = int(labels.max()) + 1
    if not PLANES[name].circular:
        return segment_median(values[None], labels, count)[0]
    mean = circular_mean(values.flatten(), area_values(image, "S", seed).flatten())
    return (segment_median(unrolled(values, mean)[None], labels, count)[0] + mean).remainder(1)


def road_samples(
    image: Tensor, names: tuple[str, ...], settings: SampleSettings, seed: SeedArea = SEED
) -> Tensor:
    """The samples of road of an image (3,H,W) in the named planes: (m,d).

    P3, section V: 13,266 pixels, or about 90 values, "the central value of the distribution
    within each superpixel", which is its median in each plane here. P3 does not name its
    superpixels; SLIC stands for them.
    """
    if settings.reduction == "none":
        planes = [area_values(image, name, seed).flatten() for name in names]
        return torch.stack(planes, 1)
    return torch.stack([segment_medians(image, name, settings, seed) for name in names], 1)
