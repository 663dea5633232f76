"""Network on an EfficientNet backbone: layout, road and ego car of whole images. Ours.

The backbone is EfficientNet-Lite0 (Tan and Le, "EfficientNet", ICML 2019; the "lite" variant of
their repository, without squeeze-and-excitation) but for its last stage, with weights learned from
ImageNet's object labels and possibly fine-tuned, or trained from random weights.
Batch normalisation is folded into the convolutions. The head, of small convolutions at 1/8 and 1/4
of the size, begins with random weights.
"""

from itertools import accumulate
from typing import Annotated, ClassVar, NamedTuple

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.settings import Settings
from roadtorch.imaging.resize import spatial_size
from roadtorch.layout.classes import NUM_CLASSES


class Stage(NamedTuple):
    """Consecutive blocks of one width: the first has the stride."""

    expansion: int
    outputs: int
    kernel: int
    stride: int
    blocks: int


STEM = 32
"""Channels of the first convolution, at 1/2 of the size."""

STAGES = (
    Stage(1, 16, 3, 1, 1),
    Stage(6, 24, 3, 2, 2),
    Stage(6, 40, 5, 2, 2),
    Stage(6, 80, 3, 2, 3),
    Stage(6, 112, 5, 1, 3),
    Stage(6, 192, 5, 2, 4),
)
"""Stages of EfficientNet-Lite0 down to 1/32 of the size, without the last."""

FEATURE_STAGES = (1, 2, 4, 5)
"""Stages whose outputs go to the head: at 1/4, 1/8, 1/16, 1/32 of the size."""


IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Mean and standard deviation of ImageNet's images; they normalise the backbone's input."""


NUM_OUTPUTS = NUM_CLASSES + 2
"""Scores: of the layout's classes, of road and of the ego car."""

UpperRows = Annotated[
    float,
    Field(
        ge=0,
        le=0.8,
        description="fraction of the rows that shows the upper three tenths of the image, which "
        "hardly show road; 0: all rows are alike",
    ),
]


class BackboneNetworkSettings(Settings):
    """Working size and widths of a backbone network."""

    height: int = Field(default=256, ge=32, le=1024, multiple_of=32, description="height, pixels")
    width: int = Field(
        default=320, ge=32, le=1024, multiple_of=32, description="width, pixels (images stretched)"
    )
    wide: int = Field(default=48, ge=8, le=512, description="channels of the head at 1/8 size")
    narrow: int = Field(default=24, ge=8, le=512, description="channels of the head at 1/4 size")
    upper_rows: UpperRows = 0.0


class Conv2dSame(nn.Conv2d):
    """A convolution with bias, padded as in TensorFlow: at stride 2, more after than before."""

    def __init__(
        self, inputs: int, outputs: int, kernel: int, stride: int, groups: int = 1
    ) -> None:
        super().__init__(inputs, outputs, kernel, stride, kernel // 2, groups=groups)

    def forward(self, input: Tensor) -> Tensor:
        """Convolve maps (B, C, H, W); H and W must be multiples of the stride.

        On CPUs a matrix product is faster than a 1×1 convolution, and padding the kernel is faster
        than padding the maps.
        """
        kernel, exporting = self.kernel_size[0], torch.compiler.is_exporting()
        if kernel == 1 and not self.training and not exporting:
            pixels = linear(input.permute(0, 2, 3, 1), self.weight.flatten(1), self.bias)
            return pixels.permute(0, 3, 1, 2)
        if self.stride[0] == 1:
            return super().forward(input)
        if exporting:
            padding = (kernel // 2 - 1, kernel // 2)
            input = F.pad(input, padding * 2)
            return F.conv2d(input, self.weight, self.bias, self.stride, 0, groups=self.groups)
        weight = F.pad(self.weight, (1, 0, 1, 0))
        return F.conv2d(input, weight, self.bias, self.stride, kernel // 2, groups=self.groups)


def linear(pixels: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """Return ``F.linear``; without gradients by oneDNN, which takes half of MKL's time."""
    is_fast = pixels.dtype == torch.float32 and torch.backends.mkldnn.is_available()
    is_fast &= pixels.device.type == "cpu"
    if not is_fast or torch.is_grad_enabled() or torch.compiler.is_compiling():
        return F.linear(pixels, weight, bias)
    return torch.ops.mkldnn._linear_pointwise(pixels, weight, bias, "none", [], "")


class Bottleneck(nn.Module):
    """An inverted bottleneck: 1×1 expansion, depthwise convolution, 1×1 projection.

    The input is added to the output where their shapes are equal.
    """

    def __init__(self, inputs: int, stage: Stage, stride: int) -> None:
        super().__init__()
        middle = inputs * stage.expansion
        self.expand = Conv2dSame(inputs, middle, 1, 1) if stage.expansion > 1 else None
        self.depthwise = Conv2dSame(middle, middle, stage.kernel, stride, middle)
        self.project = Conv2dSame(middle, stage.outputs, 1, 1)
        self.has_shortcut = stride == 1 and inputs == stage.outputs

    def forward(self, maps: Tensor) -> Tensor:
        """Return maps (B, outputs, H/stride, W/stride) for maps (B, inputs, H, W)."""
        in_place = not self.training
        expanded = maps if self.expand is None else F.relu6(self.expand(maps), in_place)
        residual = self.project(F.relu6(self.depthwise(expanded), in_place))
        return maps + residual if self.has_shortcut else residual


class Backbone(nn.Module):
    """EfficientNet-Lite0 as a feature extractor with four outputs."""

    def __init__(self) -> None:
        super().__init__()
        ends = list(accumulate(stage.blocks for stage in STAGES))
        self.feature_blocks = [ends[number] - 1 for number in FEATURE_STAGES]
        self.stem = Conv2dSame(3, STEM, 3, 2)
        self.blocks, inputs = nn.ModuleList(), STEM
        for stage in STAGES:
            for number in range(stage.blocks):
                self.blocks.append(Bottleneck(inputs, stage, 1 if number else stage.stride))
                inputs = stage.outputs

    def forward(self, images: Tensor) -> list[Tensor]:
        """Return features of images (B, 3, H, W) in [0, 1] at 1/4, 1/8, 1/16, 1/32 size."""
        mean, std = (images.new_tensor(row)[:, None, None] for row in (IMAGENET_MEAN, IMAGENET_STD))
        maps, features = F.relu6(self.stem((images - mean) / std)), []
        for number, block in enumerate(self.blocks):
            maps = block(maps)
            if number in self.feature_blocks:
                features.append(maps)
        return features


class Head(nn.Module):
    """A decoder from the backbone's maps and pixel coordinates to scores at 1/4 of the size."""

    def __init__(self, wide: int, narrow: int) -> None:
        super().__init__()
        channels = [STAGES[number].outputs for number in FEATURE_STAGES]
        self.norms = nn.ModuleList(nn.BatchNorm2d(count) for count in channels)
        self.fine = Conv2dSame(channels[0], narrow, 1, 1)
        self.middle = nn.ModuleList(Conv2dSame(count, wide, 1, 1) for count in channels[1:])
        self.position = Conv2dSame(2, wide, 1, 1)
        self.context = nn.ModuleList(
            nn.Conv2d(wide, wide, 3, padding=step, dilation=step) for step in (1, 2, 4)
        )
        self.narrowed = Conv2dSame(wide, narrow, 1, 1)
        self.last = nn.Conv2d(narrow, narrow, 3, padding=1)
        self.scores = Conv2dSame(narrow, NUM_OUTPUTS, 1, 1)
        self.drop = nn.Dropout2d(0.15)

    def forward(self, features: list[Tensor]) -> Tensor:
        """Return scores (B, 5, H/4, W/4): three layout classes, road, ego car."""
        features = [self.drop(norm(maps)) for norm, maps in zip(self.norms, features, strict=True)]
        eighth, *coarser = (f(maps) for f, maps in zip(self.middle, features[1:], strict=True))
        maps = eighth + self.position(coordinate_planes(eighth))
        for scale in coarser:
            maps = maps + _resize(scale, spatial_size(eighth))
        maps = F.relu(maps)
        for convolution in self.context:
            maps = maps + F.relu(convolution(maps))
        fine = self.fine(features[0])
        fine = F.relu(fine + _resize(self.narrowed(maps), spatial_size(fine)))
        return self.scores(fine + F.relu(self.last(fine)))


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


def _resize(maps: Tensor, size: tuple[int, int]) -> Tensor:
    return F.interpolate(maps, size, mode="bilinear", align_corners=False)


class BackboneNetwork(nn.Module):
    """Layout, road and ego car of whole images from the features of a backbone."""

    kind: ClassVar[str] = "images, backbone"
    title: ClassVar[str] = "a whole-image network"

    def __init__(self, settings: BackboneNetworkSettings | None = None) -> None:
        super().__init__()
        self.settings = settings or BackboneNetworkSettings()
        self.backbone = Backbone()
        self.head = Head(self.settings.wide, self.settings.narrow)

    def train(self, mode: bool = True) -> "BackboneNetwork":
        """Set the training mode, but keep batch statistics fixed and dropout off."""
        super().train(mode)
        self.head.norms.eval()
        self.head.drop.eval()  # its random numbers would have no seed
        return self

    def forward(self, images: Tensor) -> Tensor:
        """Return scores (B, 5, H/4, W/4) of images (B, 3, H, W) in [0, 1]."""
        return self.encode(images)[0]

    def encode(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return the scores of ``forward`` and the backbone's features (B, 24, H/4, W/4)."""
        features = self.backbone(images)
        return self.head(features).contiguous(), features[0]  # its layout decides rounding later on
