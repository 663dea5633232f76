"""Layout, road and ego car from the features of a backbone that knows the looks of things. Ours.

The backbone is EfficientNet-Lite0 (Tan and Le, "EfficientNet", ICML 2019; the "lite" variants of
their repository, without squeeze-and-excitation) as far as its fifteenth block, its weights as
they were learned from ImageNet's object labels, or learned on from there. Batch normalisation is
part of the convolutions here. What is learned for roads anew are the heads: small convolutions at
an eighth and a quarter of the size. Several heads that began differently are averaged.
"""

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.settings import Settings
from roadtorch.imaging.resize import size_of
from roadtorch.layout.image_network import OUTPUTS, cues_of, place_planes
from roadtorch.layout.patch_network import Normalisation


class Block(NamedTuple):
    """An inverted bottleneck: channels in, widened so many times, out; kernel and stride."""

    inputs: int
    widened: int
    outputs: int
    kernel: int
    stride: int


STEM = 32
"""Channels of the first convolution, at half the size."""

BLOCKS = (
    Block(32, 1, 16, 3, 1),
    Block(16, 6, 24, 3, 2),
    Block(24, 6, 24, 3, 1),
    Block(24, 6, 40, 5, 2),
    Block(40, 6, 40, 5, 1),
    Block(40, 6, 80, 3, 2),
    Block(80, 6, 80, 3, 1),
    Block(80, 6, 80, 3, 1),
    Block(80, 6, 112, 5, 1),
    Block(112, 6, 112, 5, 1),
    Block(112, 6, 112, 5, 1),
    Block(112, 6, 192, 5, 2),
    Block(192, 6, 192, 5, 1),
    Block(192, 6, 192, 5, 1),
    Block(192, 6, 192, 5, 1),
)
"""Of EfficientNet-Lite0, up to a thirty-second of the size; the last one is left out."""

KEPT = (2, 4, 10, 14)
"""Blocks whose maps the heads see: at a quarter, an eighth, a sixteenth, a thirty-second."""

MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of ImageNet's images, by which the backbone's input is normalised."""


class BackboneNetworkSettings(Settings):
    """The size it works at, and its heads."""

    height: int = Field(default=256, ge=32, le=1024, multiple_of=32, description="rows it works at")
    width: int = Field(
        default=320, ge=32, le=1024, multiple_of=32, description="columns; images are stretched"
    )
    wide: int = Field(default=48, ge=8, le=512, description="channels of a head at an eighth")
    narrow: int = Field(default=24, ge=8, le=512, description="channels of a head at a quarter")
    heads: int = Field(default=3, ge=1, le=16, description="heads that are averaged")
    normalisation: Normalisation = Normalisation(kind="none")


class SamePadded(nn.Conv2d):
    """A convolution with bias whose padding at stride 2 is TensorFlow's: one more at the end."""

    def __init__(
        self, inputs: int, outputs: int, kernel: int, stride: int, groups: int = 1
    ) -> None:
        super().__init__(inputs, outputs, kernel, stride, kernel // 2, groups=groups)

    def forward(self, maps: Tensor) -> Tensor:
        """Maps (B,outputs,H/stride,W/stride); H and W are multiples of the stride.

        On processors a product of matrices is faster than torch's convolution of single pixels,
        and a kernel with a row and a column of zeros than padded maps, which are copies.
        """
        kernel, exporting = self.kernel_size[0], torch.compiler.is_exporting()
        if kernel == 1 and not self.training and not exporting:
            pixels = F.linear(maps.permute(0, 2, 3, 1), self.weight[:, :, 0, 0], self.bias)
            return pixels.permute(0, 3, 1, 2)
        if self.stride[0] == 1:
            return super().forward(maps)
        if exporting:
            ends = (kernel // 2 - 1, kernel // 2)
            maps = F.pad(maps, ends * 2)
            return F.conv2d(maps, self.weight, self.bias, self.stride, 0, groups=self.groups)
        weight = F.pad(self.weight, (1, 0, 1, 0))
        return F.conv2d(maps, weight, self.bias, self.stride, kernel // 2, groups=self.groups)


class Bottleneck(nn.Module):
    """Widen, look around in each channel, narrow; added to what came in where shapes allow."""

    def __init__(self, block: Block) -> None:
        super().__init__()
        middle = block.inputs * block.widened
        self.widen = SamePadded(block.inputs, middle, 1, 1) if block.widened > 1 else None
        self.look = SamePadded(middle, middle, block.kernel, block.stride, middle)
        self.narrow = SamePadded(middle, block.outputs, 1, 1)
        self.added = block.stride == 1 and block.inputs == block.outputs

    def forward(self, maps: Tensor) -> Tensor:
        """Maps (B,outputs,H/stride,W/stride) of maps (B,inputs,H,W)."""
        in_place = not self.training
        wide = maps if self.widen is None else F.relu6(self.widen(maps), in_place)
        changed = self.narrow(F.relu6(self.look(wide), in_place))
        return maps + changed if self.added else changed


class Backbone(nn.Module):
    """The frozen part: four maps of features of an image."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = SamePadded(3, STEM, 3, 2)
        self.blocks = nn.ModuleList(Bottleneck(block) for block in BLOCKS)

    def forward(self, images: Tensor) -> list[Tensor]:
        """Maps (B,24,H/4,W/4), (B,40,H/8,W/8), (B,112,H/16,W/16), (B,192,H/32,W/32) of
        images (B,3,H,W) in [0,1]."""
        mean, deviation = (images.new_tensor(row)[:, None, None] for row in (MEAN, DEVIATION))
        maps, kept = F.relu6(self.stem((images - mean) / deviation)), []
        for number, block in enumerate(self.blocks):
            maps = block(maps)
            if number in KEPT:
                kept.append(maps)
        return kept


class Head(nn.Module):
    """What is learned: from the backbone's maps and the place to scores at a quarter."""

    def __init__(self, wide: int, narrow: int) -> None:
        super().__init__()
        channels = [BLOCKS[number].outputs for number in KEPT]
        self.levels = nn.ModuleList(nn.BatchNorm2d(count) for count in channels)
        self.fine = nn.Conv2d(channels[0], narrow, 1)
        self.middle = nn.ModuleList(nn.Conv2d(count, wide, 1) for count in channels[1:])
        self.place = nn.Conv2d(2, wide, 1)
        self.around = nn.ModuleList(
            nn.Conv2d(wide, wide, 3, padding=step, dilation=step) for step in (1, 2, 4)
        )
        self.narrowed = nn.Conv2d(wide, narrow, 1)
        self.last = nn.Conv2d(narrow, narrow, 3, padding=1)
        self.scores = nn.Conv2d(narrow, OUTPUTS, 1)
        self.drop = nn.Dropout2d(0.15)

    def forward(self, features: list[Tensor]) -> Tensor:
        """Scores (B,5,H/4,W/4): three classes, road, ego car."""
        levels = [self.drop(norm(maps)) for norm, maps in zip(self.levels, features, strict=True)]
        eighth, *coarser = (f(maps) for f, maps in zip(self.middle, levels[1:], strict=True))
        maps = eighth + self.place(place_planes(eighth))
        for level in coarser:
            maps = maps + _sized(level, size_of(eighth))
        maps = F.relu(maps)
        for change in self.around:
            maps = maps + F.relu(change(maps))
        fine = self.fine(levels[0])
        fine = F.relu(fine + _sized(self.narrowed(maps), size_of(fine)))
        return self.scores(fine + F.relu(self.last(fine)))


def _sized(maps: Tensor, size: tuple[int, int]) -> Tensor:
    return F.interpolate(maps, size, mode="bilinear", align_corners=False)


class BackboneNetwork(nn.Module):
    """Layout, road and ego car of whole images, seen through the backbone."""

    kind: ClassVar[str] = "images, backbone"

    def __init__(self, settings: BackboneNetworkSettings | None = None) -> None:
        super().__init__()
        self.settings = settings or BackboneNetworkSettings()
        self.backbone = Backbone()
        wide, narrow = self.settings.wide, self.settings.narrow
        self.heads = nn.ModuleList(Head(wide, narrow) for _ in range(self.settings.heads))

    def train(self, mode: bool = True) -> "BackboneNetwork":
        """Learn on, or not; statistics stay what they were: batches of a few streets wander."""
        super().train(mode)
        for head in self.heads:
            head.get_submodule("levels").eval()
            head.get_submodule("drop").eval()  # it would draw what no seed of a run tells
        return self

    def last_layers(self) -> list[nn.Conv2d]:
        """Those that give the scores, of each head."""
        return [head.get_submodule("scores") for head in self.heads]  # type: ignore[misc]

    def forward(self, images: Tensor) -> Tensor:
        """Scores (B,5,H/4,W/4) of images (B,3,H,W) in [0,1], the mean of the heads'."""
        features = self.backbone(images)
        return torch.stack([head(features) for head in self.heads]).mean(0)

    @torch.no_grad()
    def cues(self, image: Tensor) -> Mapping[str, Tensor]:
        """Of an image (3,H,W): ``layout`` (3,H,W), ``road`` and ``ego`` (H,W), all in [0,1]."""
        return cues_of(self, image, self.settings)
