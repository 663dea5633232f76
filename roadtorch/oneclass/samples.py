"""Where the samples of road come from, and each value of a picture only once (P3, section V).

What depends on the picture alone is marked ``shareable``: many classifiers that look at one
picture make it once. The planes are those of the distinct colours, so that a sample and a
pixel of one colour have the same values to the bit.
"""

from typing import Literal, NamedTuple

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.color import PLANES, plane
from roadtorch.oneclass.axes import circular_mean, unrolled
from roadtorch.settings import Settings
from roadtorch.sharing import shareable
from roadtorch.superpixels import segment_median, slic

FRAME = (480, 640)
"""Height and width of the frame in which the area is described. P3 does not give the size of
its pictures; this is that of the same authors' other road papers."""

LEAST = 8
"""Pixels that the area has on each side, where the picture has them."""

GRID_SHAPE = 15 / 6
"""Columns over rows of the cells that stand in for superpixels: 6x15 for 90."""

ALIKE = 1e-3
"""Values this close to a whole level of 255 are taken for 8-bit values."""


class TrainingArea(Settings):
    """The rectangle at the middle of the bottom edge whose pixels are samples of road."""

    height: int = Field(
        default=66, ge=1, le=FRAME[0], description="rows, of a frame of 480; scaled with the image"
    )
    width: int = Field(
        default=201, ge=1, le=FRAME[1], description="columns, of a frame of 640; scaled likewise"
    )

    def within(self, height: int, width: int) -> tuple[slice, slice]:
        """Its rows and columns in a picture of height × width; P3: 201×66, 13,266 pixels."""
        rows = min(height, max(LEAST, round(self.height * height / FRAME[0])))
        columns = min(width, max(LEAST, round(self.width * width / FRAME[1])))
        left = (width - columns) // 2
        return slice(height - rows, height), slice(left, left + columns)


class SampleSettings(Settings):
    """The area, and how many samples are made of it."""

    area: TrainingArea = TrainingArea()
    reduction: Literal["superpixels", "grid", "none"] = Field(
        default="superpixels",
        description="one sample per superpixel of the area, or per cell of a grid, or each pixel",
    )
    segments: int = Field(
        default=90, ge=1, le=10**5, description="superpixels or cells to aim at; P3: about 90"
    )
    central: Literal["median", "medoid"] = Field(
        default="median",
        description="the sample of a superpixel: its median in each plane, or the pixel nearest "
        "to that; P3: the central value",
    )


class AllSampleSettings(SampleSettings):
    """The same with every pixel of the area, as P3 has it for its histograms."""

    reduction: Literal["superpixels", "grid", "none"] = Field(
        default="none",
        description="one sample per superpixel of the area, or per cell of a grid, or each pixel",
    )


class Palette(NamedTuple):
    """Values that occur in a picture, and where: values (d,k), index int64 (H,W) into them."""

    values: Tensor
    index: Tensor


@shareable
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


@shareable
def plane_values(image: Tensor, name: str) -> Palette:
    """The distinct values of one plane of an image (3,H,W): values (1,k)."""
    palette = colours(image)
    values, index = plane(palette.values[:, None], name)[0].unique(return_inverse=True)
    return Palette(values[None], index[palette.index])


@shareable
def colour_plane(image: Tensor, name: str) -> Tensor:
    """One plane of the distinct colours of an image (3,H,W): (k,)."""
    return plane(colours(image).values[:, None], name)[0]


def representation(image: Tensor, names: tuple[str, ...]) -> Palette:
    """The distinct values of one or several planes of an image (3,H,W): values (d,k)."""
    if len(names) == 1:
        return plane_values(image, names[0])
    return Palette(torch.stack([colour_plane(image, name) for name in names]), colours(image).index)


@shareable
def area_segments(image: Tensor, settings: SampleSettings) -> Tensor:
    """Labels int64 (h,w) of the training area: superpixels, or cells of a grid."""
    height, width = image.shape[-2:]
    rows, columns = settings.area.within(height, width)
    area = image[:, rows, columns]
    if settings.reduction == "superpixels":
        return slic(area, settings.segments)
    height, width = area.shape[-2:]
    down = min(height, max(1, round((settings.segments / GRID_SHAPE) ** 0.5)))
    across = min(width, max(1, round(settings.segments / down)))
    row, column = (torch.arange(n) * cells // n for n, cells in ((height, down), (width, across)))
    return row[:, None] * across + column


@shareable
def area_values(image: Tensor, name: str, area: TrainingArea) -> Tensor:
    """One plane in the training area of an image: (h,w)."""
    palette = colours(image)
    return colour_plane(image, name)[palette.index[area.within(*palette.index.shape)]]


@shareable
def segment_medians(image: Tensor, name: str, settings: SampleSettings) -> Tensor:
    """The lower median of one plane in each superpixel of the training area: (m,).

    Of hue the median along the circle, seen from the mean hue of the area.
    """
    values = area_values(image, name, settings.area)
    labels = area_segments(image, settings)
    count = int(labels.max()) + 1
    if not PLANES[name].circular:
        return segment_median(values[None], labels, count)[0]
    mean = circular_mean(values.flatten(), area_values(image, "S", settings.area).flatten())
    return (segment_median(unrolled(values, mean)[None], labels, count)[0] + mean).remainder(1)


def road_samples(image: Tensor, names: tuple[str, ...], settings: SampleSettings) -> Tensor:
    """The samples of road of an image (3,H,W) in the named planes: (m,d).

    P3, section V: 13,266 pixels, or about 90 values, "the central value of the distribution
    within each superpixel". P3 does not name its superpixels; SLIC stands for them.
    """
    if settings.reduction == "none":
        planes = [area_values(image, name, settings.area).flatten() for name in names]
        return torch.stack(planes, 1)
    medians = torch.stack([segment_medians(image, name, settings) for name in names], 1)
    if settings.central == "median":
        return medians
    return _medoids(image, names, settings, medians)


def _medoids(
    image: Tensor, names: tuple[str, ...], settings: SampleSettings, medians: Tensor
) -> Tensor:
    """The pixel of each superpixel that is nearest to its median: (m,d)."""
    pixels = road_samples(image, names, settings.model_copy(update={"reduction": "none"}))
    label = area_segments(image, settings).flatten()
    difference = pixels - medians[label]
    circular = [place for place, name in enumerate(names) if PLANES[name].circular]
    difference[:, circular] = unrolled(difference[:, circular], 0)
    squared = difference.square().sum(1)
    order = squared.argsort(stable=True)
    order = order[label[order].argsort(stable=True)]
    size = torch.bincount(label, minlength=len(medians))
    return pixels[order[size.cumsum(0) - size]]
