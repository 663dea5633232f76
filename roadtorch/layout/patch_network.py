"""Convolutional networks of P2, section 3, on patches and on every pixel.

A patch network scores the square around a pixel as sky, vertical, horizontal: convolution, tanh,
2×2 subsampling, convolution, tanh (some of the family: a second subsampling), convolution,
potentials in [0, 1]. CNN-7 is the network that P2 selects, and the default here.
"""

from typing import ClassVar, Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.errors import ConfigError
from roadtorch.base.settings import Settings
from roadtorch.imaging.color import Exposure, brighten, color_plane
from roadtorch.imaging.resize import WorkingSize
from roadtorch.layout.classes import NUM_CLASSES

MIN_KERNEL, MAX_KERNEL = 5, 13


class Topology(Settings):
    """Patch size, kernels and subsampling of a patch network.

    The defaults are CNN-7 (P2, Fig. 4). Raises ConfigError for sizes that do not end in 1×1.
    """

    patch: Literal[32, 48, 64] = Field(
        default=32, description="side of the patch, pixels; Álvarez 2012, Fig. 3, compares these"
    )
    input: Literal["colour", "grey"] = Field(
        default="colour", description="input planes: RGB, or luma alone (Álvarez 2012, section 6.1)"
    )
    k1: int = Field(
        default=4, ge=1, le=64, description="kernels of the first layer; Álvarez 2012: 4 or 6"
    )
    k2: int = Field(
        default=16, ge=1, le=256, description="kernels of the second layer; Álvarez 2012: 10 to 130"
    )
    connections: int = Field(
        default=0,
        ge=0,
        le=64,
        description="maps of the first layer connected to each second kernel; 0: all",
    )
    size1: int = Field(
        default=7, ge=MIN_KERNEL, le=MAX_KERNEL, description="odd side of first kernels, pixels"
    )
    size2: int = Field(
        default=7, ge=MIN_KERNEL, le=MAX_KERNEL, description="side of the second kernels, pixels"
    )
    size3: int = Field(
        default=7, ge=MIN_KERNEL, le=MAX_KERNEL, description="side of the last kernels, pixels"
    )
    subsamplings: Literal[1, 2] = Field(
        default=1, description="number of 2×2 subsamplings: after the first layer, or after both"
    )
    pooling: Literal["mean", "max"] = Field(
        default="mean", description="2×2 subsampling: mean or maximum of four values"
    )
    potentials: Literal["sigmoid", "softmax"] = Field(
        default="sigmoid", description="output: three independent sigmoids, or a softmax"
    )

    @model_validator(mode="after")
    def _check_output_size(self) -> "Topology":
        side = self.patch
        for stage, size in enumerate((self.size1, self.size2, self.size3), 1):
            side -= size - 1
            if stage <= self.subsamplings:
                side = side // 2 if side % 2 == 0 else 0
            if side < 1:
                message = f"leaves an empty or odd-sized map after size{stage}"
                hint = "the usual sizes are 7, 7, 7 for a patch of 32"
                raise ConfigError("network.topology", message, hint)
        if side != 1:
            fits = self.size3 + side - 1
            hint = "give a smaller patch, larger kernels or one more subsampling"
            hint = f"size3={fits} would end in 1×1" if fits <= MAX_KERNEL else hint
            raise ConfigError("network.topology", f"ends in {side}×{side}, not in 1×1", hint)
        if self.connections > self.k1:
            message = f"is {self.connections}, but the first layer has {self.k1} kernels"
            raise ConfigError("network.topology.connections", message, f"give 0 to {self.k1}")
        return self

    @property
    def stride(self) -> int:
        """Distance in pixels between neighbouring outputs on a whole image."""
        return 2**self.subsamplings


# --- normalisation -----------------------------------------------------------------------

FIXED_MEAN, FIXED_GAIN = 0.5, 4.0
"""Levels in [0, 1] become values in [-2, 2], near the unit variance that suits tanh."""


class Normalisation(Settings):
    """Normalisation of an image before a network."""

    kind: Literal["fixed", "brightened"] = Field(
        default="fixed",
        description="fixed: constant offset and gain; brightened: the exposure corrected first, as "
        "for the labeller",
    )
    exposure: Exposure = Exposure()


def normalise(image: Tensor, normalisation: Normalisation) -> Tensor:
    """Normalise an image (3, H, W) in [0, 1]. Ours; P2 says "RGB pixel values"."""
    if normalisation.kind == "brightened":
        image = brighten(image, normalisation.exposure)
    return (image - FIXED_MEAN) * FIXED_GAIN


# --- the network ---------------------------------------------------------------------------


class PatchNetworkSettings(Settings):
    """Settings of a patch network and of the image's preparation."""

    topology: Topology = Topology()
    normalisation: Normalisation = Normalisation()
    working: WorkingSize = WorkingSize()


class PatchNetwork(nn.Module):
    """CNN-7 and its family (P2, section 3 and Fig. 2).

    ``forward`` takes normalised patches, ``forward_dense`` normalised whole images, ``potentials``
    an image as read.
    """

    kind: ClassVar[str] = "patches"
    title: ClassVar[str] = "a patch network (CNN-7)"
    table: Tensor

    def __init__(self, settings: PatchNetworkSettings | None = None) -> None:
        super().__init__()
        self.settings = settings or PatchNetworkSettings()
        shape = self.settings.topology
        self.first = nn.Conv2d(3 if shape.input == "colour" else 1, shape.k1, shape.size1)
        self.second = nn.Conv2d(shape.k1, shape.k2, shape.size2)
        self.last = nn.Conv2d(shape.k2, NUM_CLASSES, shape.size3)
        table = connection_table(shape.k1, shape.k2, shape.connections)
        self.register_buffer("table", table[:, :, None, None].float(), persistent=False)
        with torch.no_grad():  # initial variance as for a kernel connected to all maps
            self.second.weight.mul_((shape.k1 / table.sum(1)).sqrt()[:, None, None, None])

    def forward(self, patches: Tensor) -> Tensor:
        """Return potentials (n, 3) in [0, 1] of normalised patches (n, 3, P, P)."""
        shape = self.settings.topology
        pool = F.avg_pool2d if shape.pooling == "mean" else F.max_pool2d
        maps = pool(self.first(self._input_planes(patches)).tanh(), 2)
        maps = F.conv2d(maps, self.second.weight * self.table, self.second.bias).tanh()
        if shape.subsamplings == 2:
            maps = pool(maps, 2)
        return self._activate(self.last(maps)).flatten(1)

    def forward_dense(self, pixels: Tensor) -> Tensor:
        """Return potentials (…, 3, H, W) for each pixel of normalised images (…, 3, H, W).

        Equal to ``forward`` on the patch around each pixel, computed once for all: subsampling
        keeps every position and later convolutions are dilated instead (Giusti et al., "Fast Image
        Scanning with Deep Max-Pooling Convolutional Neural Networks", ICIP 2013). The border is
        reflected.
        """
        shape = self.settings.topology
        maps = self._input_planes(reflect_pad(pixels, shape.patch))
        maps = _pool_densely(self.first(maps).tanh(), 1, shape.pooling)
        maps = F.conv2d(maps, self.second.weight * self.table, self.second.bias, dilation=2).tanh()
        if shape.subsamplings == 2:
            maps = _pool_densely(maps, 2, shape.pooling)
        maps = F.conv2d(maps, self.last.weight, self.last.bias, dilation=shape.stride)
        return self._activate(maps)

    @torch.no_grad()
    def potentials(self, image: Tensor) -> Tensor:
        """Return potentials (3, H, W) for each pixel of an image (3, H, W) in [0, 1]."""
        pixels = normalise(image, self.settings.normalisation)
        return self.forward_dense(pixels.to(self.first.weight)).to(image)

    def _input_planes(self, pixels: Tensor) -> Tensor:
        """Return the input of the first layer: pixels (…, 3, H, W), or their luma (…, 1, H, W)."""
        if self.settings.topology.input == "colour":
            return pixels
        return color_plane(pixels, "grey").unsqueeze(-3)

    def _activate(self, scores: Tensor) -> Tensor:
        if self.settings.topology.potentials == "softmax":
            return scores.softmax(-3)
        return scores.sigmoid()


def connection_table(k1: int, k2: int, connections: int) -> Tensor:
    """Return which of k1 maps each of k2 second kernels is connected to, bool (k2, k1).

    P2, Fig. 2, mentions "the number of kernel combinations between layers" without a table. Ours:
    kernel i is connected to the maps i, i+1, … modulo k1, so that all maps are used equally often,
    up to one. With 0 connections, all.
    """
    offset = (torch.arange(k1) - torch.arange(k2)[:, None]).remainder(k1)
    return offset < (connections or k1)


def reflect_pad(pixels: Tensor, patch: int) -> Tensor:
    """Pad pixels (…, H, W) by P/2 before and P/2 - 1 after, reflected as often as necessary."""
    for axis in (-2, -1):
        length = pixels.shape[axis]
        index = torch.arange(-(patch // 2), length + patch - patch // 2 - 1, device=pixels.device)
        last = torch.full_like(index, length - 1)  # a tensor, as is the length in an exported graph
        period = (2 * last).clamp_min(1)
        index = index.remainder(period)
        index = torch.minimum(torch.minimum(index, period - index), last)
        pixels = pixels.index_select(axis, index)
    return pixels


def _pool_densely(maps: Tensor, spacing: int, pooling: str) -> Tensor:
    """Pool maps (B, C, H, W) over 2×2 values, ``spacing`` pixels apart, at every position."""
    for axis in (-2, -1):
        length = maps.shape[axis] - spacing
        first, second = maps.narrow(axis, 0, length), maps.narrow(axis, spacing, length)
        maps = (first + second) / 2 if pooling == "mean" else torch.maximum(first, second)
    return maps
