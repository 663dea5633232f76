"""A small network that sees the whole image: layout, road and ego car at once. Ours.

A patch network sees 32 pixels and does not know where they are. This one works on a small
copy of the whole image with two more planes, the place: three stages that halve the
image, a middle of dilated convolutions that see all of it, and back from an eighth to a
half of the size with what the early stages kept (added, after Lin et al., "Feature Pyramid
Networks", 2017). One head says sky, vertical, horizontal, the others road and ego car.
"""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, cast

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.settings import Settings
from roadtorch.imaging.resize import resized, size_of
from roadtorch.layout.classes import CLASSES
from roadtorch.layout.patch_network import Normalisation, normalise

DILATIONS = (1, 2, 4, 8, 1)
"""Of the middle's convolutions, in eighths of the image: 15×20 cells are seen whole."""

GROUP = 8
"""Channels that are normalised together; widths are multiples of it."""

ROAD, EGO = CLASSES, CLASSES + 1
"""Places of the further outputs, after the classes of the layout."""

OUTPUTS = CLASSES + 2

NetworkScale = Annotated[float, Field(ge=0.25, le=4)]
"""Of the size at which a network sees images, against that for which it is written."""

STEP = 32
"""Pixels by which the sides differ at which networks see images: halved five times."""


class ImageNetworkSettings(Settings):
    """The network for whole images: the size it works at, and its width."""

    height: int = Field(default=120, ge=32, le=1024, multiple_of=8, description="rows it works at")
    width: int = Field(
        default=160, ge=32, le=1024, multiple_of=8, description="columns; images are stretched"
    )
    narrow: int = Field(
        default=16, ge=8, le=256, multiple_of=GROUP, description="channels of the first stage"
    )
    wide: int = Field(
        default=96, ge=8, le=512, multiple_of=GROUP, description="channels of the middle"
    )
    normalisation: Normalisation = Normalisation()


class ImageNetwork(nn.Module):
    """Layout, road and ego car of whole images.

    Groups of channels are normalised within one image, so that a batch of any size, cut in
    any way, gives the same gradients.
    """

    kind: ClassVar[str] = "images"

    def __init__(self, settings: ImageNetworkSettings | None = None) -> None:
        super().__init__()
        self.settings = settings or ImageNetworkSettings()
        narrow, wide = self.settings.narrow, self.settings.wide
        self.first = Stage(3 + 2, narrow, stride=2)
        self.second = nn.Sequential(Stage(narrow, 2 * narrow, stride=2), Residual(2 * narrow))
        self.third = Stage(2 * narrow, wide, stride=2)
        self.middle = nn.Sequential(*(Residual(wide, dilation) for dilation in DILATIONS))
        self.narrowed_quarter = nn.Conv2d(wide, 2 * narrow, 1)
        self.to_quarter = Stage(2 * narrow, 2 * narrow)
        self.narrowed_half = nn.Conv2d(2 * narrow, narrow, 1)
        self.to_half = Stage(narrow, narrow)
        self.heads = nn.Conv2d(narrow, OUTPUTS, 1)

    def last_layers(self) -> list[nn.Conv2d]:
        """Those that give the scores."""
        return [self.heads]

    def forward(self, pixels: Tensor) -> Tensor:
        """Scores (B,5,H/2,W/2) of normalised images (B,3,H,W): three classes, road, ego.

        H and W are multiples of 8. ``potentials_of`` turns scores into potentials.
        """
        half = self.first(torch.cat([pixels, place_planes(pixels)], 1))
        quarter = self.second(half)
        deep = self.middle(self.third(quarter))
        quarter = self.to_quarter(quarter + _doubled(self.narrowed_quarter(deep)))
        half = self.to_half(half + _doubled(self.narrowed_half(quarter)))
        return self.heads(half)

    @torch.no_grad()
    def cues(self, image: Tensor) -> Mapping[str, Tensor]:
        """Of an image (3,H,W): ``layout`` (3,H,W), ``road`` and ``ego`` (H,W), all in [0,1]."""
        return cues_of(self, image, self.settings)


def cues_of(network: nn.Module, image: Tensor, settings: Any) -> Mapping[str, Tensor]:
    """What a network that works at a size and gives scores says of an image, as its ``cues``.

    settings: its height, width and normalisation. Of a batch (N,3,H,W) in an exported graph.
    """
    small = resized(image, (settings.height, settings.width)).clamp(0, 1)
    pixels = normalise(small, settings.normalisation).pixels
    batch = pixels if pixels.ndim == 4 else pixels[None]
    potentials = potentials_of(network(batch.to(next(network.parameters()))).to(image))
    potentials = resized(potentials if pixels.ndim == 4 else potentials[0], size_of(image))
    layout, road, ego = potentials.clamp(0, 1).split([CLASSES, 1, 1], -3)
    return {"layout": layout, "road": road.squeeze(-3), "ego": ego.squeeze(-3)}


def scaled(height: int, width: int, scale: float) -> tuple[int, int]:
    """A height and width so many times as large, as multiples of ``STEP``; at 1 as they are."""
    if scale == 1:
        return height, width
    rows, columns = (max(1, round(scale * side / STEP)) * STEP for side in (height, width))
    return rows, columns


class Stage(nn.Sequential):
    """A convolution, groups of channels normalised, and what is negative cut off.

    In one call: maps are so small that a call for each module would take a fifth of the time.
    """

    def __init__(self, inputs: int, outputs: int, stride: int = 1, dilation: int = 1) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, stride, dilation, dilation, bias=False),
            nn.GroupNorm(outputs // GROUP, outputs),
        )

    def forward(self, maps: Tensor) -> Tensor:
        """Maps (B,outputs,H/stride,W/stride) of maps (B,inputs,H,W)."""
        convolution, groups = cast("tuple[nn.Conv2d, nn.GroupNorm]", tuple(self))
        stride, dilation = convolution.stride, convolution.dilation  # which is the padding too
        maps = torch.conv2d(maps, convolution.weight, None, stride, dilation, dilation)
        return torch.group_norm(maps, groups.num_groups, groups.weight, groups.bias).relu_()


class Residual(nn.Module):
    """x + a convolution of x, both of the same width."""

    def __init__(self, channels: int, dilation: int = 1) -> None:
        super().__init__()
        self.change = Stage(channels, channels, dilation=dilation)

    def forward(self, maps: Tensor) -> Tensor:
        """Maps (B,C,H,W), changed a little."""
        return maps + self.change(maps)


def _doubled(maps: Tensor) -> Tensor:
    return F.interpolate(maps, scale_factor=2, mode="bilinear", align_corners=False)


def place_planes(pixels: Tensor) -> Tensor:
    """|x| and y (B,2,H,W) of images (B,3,H,W), from -1 to 1: a mirrored street is a street."""
    batch, _, height, width = pixels.shape
    rows, columns = (
        torch.linspace(1 / side - 1, 1 - 1 / side, side, dtype=pixels.dtype, device=pixels.device)
        for side in (height, width)
    )
    away = (2 * columns.abs() - 1).expand(height, width)
    down = rows[:, None].expand(height, width)
    return torch.stack([away, down]).expand(batch, 2, height, width)


def potentials_of(scores: Tensor) -> Tensor:
    """Scores (B,5,…) as potentials in [0,1]: three shares that sum to 1, road, ego."""
    return torch.cat([scores[:, :CLASSES].softmax(1), scores[:, CLASSES:].sigmoid()], 1)
