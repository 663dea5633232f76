"""Samples of road from the seed area, and the distinct values of an image (P3, section V).

Results that depend on the image alone are ``cached_per_image``: many classifiers of one image share
them. Planes are computed from distinct colours, so that a sample and a pixel of one colour have
bit-identical values.
"""

from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.image_cache import cached_per_image
from roadtorch.base.settings import Settings
from roadtorch.imaging.color import PLANES, color_plane
from roadtorch.imaging.segments import segment_median
from roadtorch.imaging.slic import slic
from roadtorch.oneclass.axes import circular_mean, unroll_hue
from roadtorch.road.seed_area import REFERENCE_SIZE, SeedArea, seed_area

MIN_SEED_SIDE = 8  # least side of the seed area in pixels, where the image is large enough
LEVEL_TOLERANCE = 1e-3  # distance to a whole level of 255 below which values count as 8-bit


class WideSeedArea(SeedArea):
    """P3's seed area, its "training area": 201×66 pixels, 13,266, of a frame of 640×480.

    P3 does not state the size of its images; this is that of the same authors' other papers.
    """

    height: float = Field(
        default=33,
        ge=1,
        le=REFERENCE_SIZE[0],
        description="height in rows, if the image has 240; scaled",
    )
    width: float = Field(
        default=100.5,
        ge=1,
        le=REFERENCE_SIZE[1],
        description="width in columns, if the image has 320; scaled",
    )


P3_SEED_AREA = WideSeedArea()  # seed area of P3


def sample_area(shape: Sequence[int], seed: SeedArea = P3_SEED_AREA) -> tuple[slice, slice]:
    """Return rows and columns of the seed area in a map of shape (…, H, W)."""
    return seed_area(shape[-2], shape[-1], seed, MIN_SEED_SIDE)


Reduction = Annotated[
    Literal["superpixels", "none"],
    Field(description="samples of the seed area: one per superpixel, or per pixel"),
]


class SampleSettings(Settings):
    """Settings of the samples from the seed area."""

    reduction: Reduction = "superpixels"
    segments: int = Field(
        default=90,
        ge=1,
        le=10**5,
        description="approximate number of superpixels; the paper: about 90",
    )


class AllSampleSettings(SampleSettings):
    """Settings with every pixel of the seed area, as P3 has for its histograms."""

    reduction: Reduction = "none"


class Palette(NamedTuple):
    """Distinct values (d, k) of an image, and their indices int64 (H, W) at each pixel."""

    values: Tensor
    indices: Tensor


@cached_per_image
def distinct_colours(image: Tensor) -> Palette:
    """Return the distinct colours of an image (3, H, W) with 8-bit levels, values (3, k).

    In any other image each pixel counts as a colour of its own.
    """
    size = image.shape[-2:]
    levels = (image * 255).round_()
    if bool(((image * 255 - levels).abs() > LEVEL_TOLERANCE).any()):
        return Palette(image.flatten(1), torch.arange(size.numel()).view(size))
    red, green, blue = levels.to(torch.int32).flatten(1)
    packed, index = (red * 65536 + green * 256 + blue).unique(return_inverse=True)
    levels = torch.stack([packed // 65536, packed // 256 % 256, packed % 256])
    return Palette(levels.to(image.dtype) / 255, index.view(size))


@cached_per_image
def plane_values(image: Tensor, name: str) -> Palette:
    """Return the distinct values of one plane of an image (3, H, W): values (1, k)."""
    palette = distinct_colours(image)
    values, index = color_plane(palette.values[:, None], name)[0].unique(return_inverse=True)
    return Palette(values[None], index[palette.indices])


@cached_per_image
def palette_plane(image: Tensor, name: str) -> Tensor:
    """Return one plane of the distinct colours of an image (3, H, W): (k,)."""
    return color_plane(distinct_colours(image).values[:, None], name)[0]


def representation(image: Tensor, names: tuple[str, ...]) -> Palette:
    """Return the distinct values of one or several planes of an image (3, H, W): values (d, k)."""
    if len(names) == 1:
        return plane_values(image, names[0])
    return Palette(
        torch.stack([palette_plane(image, name) for name in names]), distinct_colours(image).indices
    )


@cached_per_image
def area_segments(image: Tensor, settings: SampleSettings, seed: SeedArea) -> Tensor:
    """Return the superpixels of the seed area, labels int64 (h, w)."""
    rows, columns = sample_area(image.shape, seed)
    return slic(image[:, rows, columns], settings.segments)


@cached_per_image
def area_values(image: Tensor, name: str, seed: SeedArea) -> Tensor:
    """Return one plane in the seed area of an image: (h, w)."""
    index = distinct_colours(image).indices
    return palette_plane(image, name)[index[sample_area(index.shape, seed)]]


@cached_per_image
def segment_medians(image: Tensor, name: str, settings: SampleSettings, seed: SeedArea) -> Tensor:
    """Return the lower median of one plane in each superpixel of the seed area: (m,).

    Medians of hue are along the circle, relative to the area's mean hue.
    """
    values = area_values(image, name, seed)
    labels = area_segments(image, settings, seed)
    count = int(labels.max()) + 1
    if not PLANES[name].circular:
        return segment_median(values[None], labels, count)[0]
    mean = circular_mean(values.flatten(), area_values(image, "S", seed).flatten())
    return (segment_median(unroll_hue(values, mean)[None], labels, count)[0] + mean).remainder(1)


def road_samples(
    image: Tensor, names: tuple[str, ...], settings: SampleSettings, seed: SeedArea = P3_SEED_AREA
) -> Tensor:
    """Return the samples of road of an image in the named planes, shape (m, d).

    P3, section V: 13,266 pixels, or about 90 values, "the central value of the distribution within
    each superpixel": here the median of each plane in SLIC superpixels, as P3 does not name its
    own.

    image: sRGB in [0, 1], shape (3, H, W).
    """
    if settings.reduction == "none":
        return torch.stack([area_values(image, name, seed).flatten() for name in names], 1)
    return torch.stack([segment_medians(image, name, settings, seed) for name in names], 1)
