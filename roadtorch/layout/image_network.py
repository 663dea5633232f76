"""Small network for whole images: layout, road and ego car at once. Ours.

A patch network has 32 pixels and no position. This one takes a small copy of the whole image and
two coordinate planes: three stages that halve the size, dilated convolutions that cover the image,
and a decoder from 1/8 to 1/2 of the size with added skip connections (after Lin et al., "Feature
Pyramid Networks", 2017). Its outputs are sky, vertical, horizontal, road and ego car.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, cast

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.settings import Settings
from roadtorch.imaging.resize import (
    resize_maps,
    round_to_pixels,
    side_length,
    spatial_size,
)
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.layout.patch_network import Normalisation, normalise

DILATIONS = (1, 2, 4, 8, 1)
"""Dilations of the middle convolutions, at 1/8 size: their receptive field covers 15×20 cells."""

GROUP_SIZE = 8
"""Channels in a group of the group normalisation; widths are multiples of it."""

ROAD_OUTPUT, EGO_OUTPUT = NUM_CLASSES, NUM_CLASSES + 1
"""Channels of the outputs after the classes of the layout."""

ROAD_CUES = ("road", "ego", "fused_road", "appearance")
"""Cues after the layout; the last two only where the road is fused."""

RoadFusion = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Log odds of road (B, h, w), features (B, C, h, w) and images (B, 3, H, W) → log odds of the fused
road and of the appearance alone (B, 2, h, w)."""

NUM_OUTPUTS = NUM_CLASSES + 2

UPPER = 0.3
"""Fraction of an image's height that is its upper part: sky, trees and roofs, hardly road."""

ROW_STEP = 8
"""Divisor of the rows of a network's input that show the upper part: three halvings."""

UpperRows = Annotated[
    float,
    Field(
        ge=0,
        le=0.8,
        description="fraction of the rows that shows the upper three tenths of the image, which "
        "hardly show road; 0: all rows are alike",
    ),
]


class ImageNetworkSettings(Settings):
    """Working size and width of the network for whole images."""

    height: int = Field(default=120, ge=32, le=1024, multiple_of=8, description="height, pixels")
    width: int = Field(
        default=160, ge=32, le=1024, multiple_of=8, description="width, pixels (images stretched)"
    )
    narrow: int = Field(
        default=16, ge=8, le=256, multiple_of=GROUP_SIZE, description="channels of the first stage"
    )
    wide: int = Field(
        default=96, ge=8, le=512, multiple_of=GROUP_SIZE, description="channels of the middle"
    )
    upper_rows: UpperRows = 0.0
    normalisation: Normalisation = Normalisation()


class ImageNetwork(nn.Module):
    """Layout, road and ego car of whole images, with group normalisation: batches do not matter."""

    kind: ClassVar[str] = "images"
    title: ClassVar[str] = "a whole-image network"

    def __init__(self, settings: ImageNetworkSettings | None = None) -> None:
        super().__init__()
        self.settings = settings or ImageNetworkSettings()
        narrow, wide = self.settings.narrow, self.settings.wide
        self.first = ConvBlock(3 + 2, narrow, stride=2)
        self.second = nn.Sequential(ConvBlock(narrow, 2 * narrow, stride=2), Residual(2 * narrow))
        self.third = ConvBlock(2 * narrow, wide, stride=2)
        self.middle = nn.Sequential(*(Residual(wide, dilation) for dilation in DILATIONS))
        self.narrowed_quarter = nn.Conv2d(wide, 2 * narrow, 1)
        self.to_quarter = ConvBlock(2 * narrow, 2 * narrow)
        self.narrowed_half = nn.Conv2d(2 * narrow, narrow, 1)
        self.to_half = ConvBlock(narrow, narrow)
        self.heads = nn.Conv2d(narrow, NUM_OUTPUTS, 1)

    def forward(self, pixels: Tensor) -> Tensor:
        """Return scores (B, 5, H/2, W/2) of normalised images (B, 3, H, W): classes, road, ego.

        H and W must be multiples of 8. ``scores_to_potentials`` turns scores into potentials.
        """
        return self.encode(pixels)[0]

    def encode(self, pixels: Tensor) -> tuple[Tensor, Tensor]:
        """Return the scores of ``forward`` and features (B, C, H/2, W/2) of the second stage."""
        half = self.first(torch.cat([pixels, coordinate_planes(pixels)], 1))
        quarter = self.second(half)
        features = _upsample(quarter)
        deep = self.middle(self.third(quarter))
        quarter = self.to_quarter(quarter + _upsample(self.narrowed_quarter(deep)))
        half = self.to_half(half + _upsample(self.narrowed_half(quarter)))
        return self.heads(half), features


@torch.no_grad()
def compute_cues(
    network: Any, image: Tensor, fuse: RoadFusion | None = None, upper_rows: float | None = None
) -> Mapping[str, Tensor]:
    """Return a whole-image network's ``layout`` (3, H, W), ``road`` and ``ego`` (H, W), in [0, 1].

    Of an image (3, H, W), in an exported graph of a batch. With ``fuse``, ``fused_road`` and
    ``appearance`` (H, W) as well. upper_rows: None: that of the network's settings.
    """
    settings = network.settings
    fraction = settings.upper_rows if upper_rows is None else upper_rows
    rows = count_upper_rows(fraction, settings.height)
    small = resize_rows(image, (settings.height, settings.width), rows).clamp(0, 1)
    pixels = normalise(small, settings.normalisation).pixels
    is_batch = pixels.ndim == 4
    images, pixels = (small, pixels) if is_batch else (small[None], pixels[None])
    encoded = network.encode(pixels.to(next(network.parameters())))
    scores, features = (maps.to(image) for maps in encoded)
    potentials = scores_to_potentials(scores)
    if fuse is not None:
        road = fuse(scores[:, ROAD_OUTPUT], features, images)
        potentials = torch.cat([potentials, road.sigmoid()], 1)
    maps = potentials if is_batch else potentials[0]
    rows = rows * maps.shape[-2] // settings.height
    maps = restore_rows(maps, spatial_size(image), rows).clamp(0, 1)
    layout, planes = maps.tensor_split((NUM_CLASSES,), -3)
    return {"layout": layout, **dict(zip(ROAD_CUES, planes.unbind(-3), strict=False))}


Resize = Callable[[Tensor, tuple[int, int]], Tensor]
"""A function that resizes maps (…, H, W) to a size."""


def resize_rows(
    maps: Tensor, size: tuple[int, int], rows: int, resize: Resize = resize_maps
) -> Tensor:
    """Resize maps (…, H, W) with so many rows for the upper part; 0: as many as it has. Ours.

    So a network sees the ground, where the road is, at more pixels.
    """
    return resize_parts(maps, upper_height(maps.shape[-2]), size, rows, resize)


def restore_rows(maps: Tensor, size: tuple[int, int], rows: int) -> Tensor:
    """Resize maps (…, h, w), of which so many rows are the upper part, to an image's size."""
    return resize_parts(maps, rows, size, upper_height(size[0]) if rows else 0, resize_maps)


def count_upper_rows(fraction: float, height: int) -> int:
    """Return the rows of a network's input, a multiple of ``ROW_STEP``, nearest to a fraction."""
    return ROW_STEP * round(fraction * height / ROW_STEP)


def upper_height(height: int) -> int:
    """Return the pixels of an image's height that are its upper part."""
    return round_to_pixels(side_length(height) * UPPER, 1)


def resize_parts(
    maps: Tensor, upper: int, size: tuple[int, int], rows: int, resize: Resize
) -> Tensor:
    """Resize the upper rows of maps (…, H, W) to so many rows, the others to the rest of a size.

    With 0 rows all are resized alike.
    """
    if not rows:
        return resize(maps, size)
    numbers = torch.arange(maps.shape[-2], device=maps.device)
    top, ground = (maps.index_select(-2, part) for part in (numbers[:upper], numbers[upper:]))
    parts = resize(top, (rows, size[1])), resize(ground, (size[0] - rows, size[1]))
    return torch.cat(parts, -2)


class ConvBlock(nn.Sequential):
    """A 3×3 convolution, group normalisation and ReLU, without the time of a call for each."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1, dilation: int = 1) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, stride, dilation, dilation, bias=False),
            nn.GroupNorm(outputs // GROUP_SIZE, outputs),
        )

    def forward(self, input: Tensor) -> Tensor:
        """Return maps (B, outputs, H/stride, W/stride) for maps (B, inputs, H, W)."""
        convolution, groups = cast("tuple[nn.Conv2d, nn.GroupNorm]", tuple(self))
        stride, dilation = convolution.stride, convolution.dilation  # also the padding
        input = torch.conv2d(input, convolution.weight, None, stride, dilation, dilation)
        return torch.group_norm(input, groups.num_groups, groups.weight, groups.bias).relu_()


class Residual(nn.Module):
    """A residual block: x + a convolution of x."""

    def __init__(self, channels: int, dilation: int = 1) -> None:
        super().__init__()
        self.change = ConvBlock(channels, channels, dilation=dilation)

    def forward(self, maps: Tensor) -> Tensor:
        """Return maps (B, C, H, W) for maps (B, C, H, W)."""
        return maps + self.change(maps)


def _upsample(maps: Tensor) -> Tensor:
    return F.interpolate(maps, scale_factor=2, mode="bilinear", align_corners=False)


def coordinate_planes(pixels: Tensor) -> Tensor:
    """Return 2|x| - 1 and y, for x and y in [-1, 1] across and down: shape (B, 2, H, W)."""
    batch, _, height, width = pixels.shape
    rows, columns = (
        torch.linspace(1 / side - 1, 1 - 1 / side, side, dtype=pixels.dtype, device=pixels.device)
        for side in (height, width)
    )
    sideways = (2 * columns.abs() - 1).expand(height, width)
    down = rows[:, None].expand(height, width)
    return torch.stack([sideways, down]).expand(batch, 2, height, width)


def scores_to_potentials(scores: Tensor) -> Tensor:
    """Return potentials of scores (B, 5, …): softmax of the layout, sigmoids of road and ego."""
    return torch.cat([scores[:, :NUM_CLASSES].softmax(1), scores[:, NUM_CLASSES:].sigmoid()], 1)
