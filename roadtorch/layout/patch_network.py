"""The convolutional networks of P2, section 3, and their application to every pixel.

A patch network looks at the square around a pixel and says how much that pixel looks like
sky, vertical, horizontal: convolution, tanh, 2×2 subsampling, convolution, tanh (in one half
of the family another subsampling), convolution, potentials in [0,1]. CNN-7 is the member of
the family that P2 selects, and the default here.
"""

import math
from typing import ClassVar, Literal, NamedTuple

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.errors import ConfigError
from roadtorch.base.settings import Settings
from roadtorch.imaging.color import Exposure, brightened, plane
from roadtorch.imaging.resize import WorkingSize
from roadtorch.layout.classes import CLASSES

MIN_KERNEL, MAX_KERNEL = 5, 13


class Topology(Settings):
    """Patch, kernels and subsampling of a network that turns a patch into one set of potentials.

    The defaults are CNN-7 (P2, Fig. 4). ConfigError for sizes that do not end in 1×1.
    """

    patch: Literal[32, 48, 64] = Field(
        default=32, description="pixels of the patch's side; Álvarez 2012 compares these (Fig. 3)"
    )
    input: Literal["colour", "grey"] = Field(
        default="colour",
        description="three planes, or their luma alone (Álvarez 2012, section 6.1)",
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
        description="maps of the first layer that each second kernel sees; 0: all",
    )
    size1: int = Field(
        default=7, ge=MIN_KERNEL, le=MAX_KERNEL, description="side of the first kernels"
    )
    size2: int = Field(
        default=7, ge=MIN_KERNEL, le=MAX_KERNEL, description="side of the second kernels"
    )
    size3: int = Field(
        default=7, ge=MIN_KERNEL, le=MAX_KERNEL, description="side of the last kernels"
    )
    subsamplings: Literal[1, 2] = Field(
        default=1, description="stages followed by 2×2 subsampling: the first, or both"
    )
    pooling: Literal["mean", "max"] = Field(
        default="mean", description="what 2×2 subsampling keeps of four values"
    )
    potentials: Literal["sigmoid", "softmax"] = Field(
        default="sigmoid", description="three answers, each for itself, or shares that sum to 1"
    )

    @model_validator(mode="after")
    def _ends_in_one(self) -> "Topology":
        side = self.patch
        for stage, size in enumerate((self.size1, self.size2, self.size3), 1):
            side -= size - 1
            if stage <= self.subsamplings:
                side = side // 2 if side % 2 == 0 else 0
            if side < 1:
                message = f"has a map behind size{stage} that is empty, or that 2×2 cannot halve"
                hint = "the usual sizes are 7, 7, 7 for a patch of 32"
                raise ConfigError("topology", message, hint)
        if side != 1:
            fits = self.size3 + side - 1
            hint = "give a smaller patch, larger kernels or one more subsampling"
            hint = f"size3={fits} would end in it" if fits <= MAX_KERNEL else hint
            raise ConfigError("topology", f"ends in {side}×{side}, not in 1×1", hint)
        if self.connections > self.k1:
            message = f"is {self.connections}, and the first layer has {self.k1} kernels"
            raise ConfigError("topology.connections", message, f"give 0 to {self.k1}")
        return self

    @property
    def stride(self) -> int:
        """Pixels between neighbouring outputs when the network runs over a whole image."""
        return 2**self.subsamplings


# --- before a network --------------------------------------------------------------------

FIXED_MEAN, FIXED_GAIN = 0.5, 4.0
"""Levels in [0,1] become values from -2 to 2, near the unit variance that tanh likes."""

MIN_DEVIATION = 0.02
"""The least deviation that an image is divided by: a flat one stays flat."""


class Normalisation(Settings):
    """What is done to an image before a network sees it."""

    kind: Literal["none", "fixed", "image", "brightened", "brightened image"] = Field(
        default="fixed",
        description="levels as they are; about zero; less the image's mean colour, over its "
        "deviation; brightened as for the labeller; or first this, then that",
    )
    exposure: Exposure = Exposure()


class Normalised(NamedTuple):
    """pixels (3,H,W) of about zero mean; gain: by how much a difference of levels has grown."""

    pixels: Tensor
    gain: float


def normalise(image: Tensor, normalisation: Normalisation) -> Normalised:
    """An image (3,H,W) in [0,1] as the networks want it. Ours; P2 says "RGB pixel values".

    In an exported graph a batch (N,3,H,W), each image for itself, of no gain.
    """
    if normalisation.kind == "none":
        return Normalised(image, 1.0)
    if normalisation.kind.startswith("brightened"):
        image = brightened(image, normalisation.exposure)
    if normalisation.kind.endswith("image"):
        centred = image - image.mean((-2, -1), keepdim=True)
        if torch.compiler.is_exporting():
            deviation = centred.square().mean((-3, -2, -1), keepdim=True).sqrt()
            return Normalised(centred / deviation.clamp(min=MIN_DEVIATION), math.nan)
        gain = 1 / max(math.sqrt(centred.square().mean()), MIN_DEVIATION)
        return Normalised(centred * gain, gain)
    return Normalised((image - FIXED_MEAN) * FIXED_GAIN, FIXED_GAIN)


# --- the network ---------------------------------------------------------------------------


class PatchNetworkSettings(Settings):
    """A patch network with what happens to the image before it."""

    topology: Topology = Topology()
    normalisation: Normalisation = Normalisation()
    working: WorkingSize = WorkingSize()


class PatchNetwork(nn.Module):
    """CNN-7 and its family. P2, section 3 and Fig. 2.

    ``forward`` takes patches, ``dense`` whole images, both normalised; ``potentials`` takes an
    image as it was read.
    """

    kind: ClassVar[str] = "patches"
    table: Tensor

    def __init__(self, settings: PatchNetworkSettings | None = None) -> None:
        super().__init__()
        self.settings = settings or PatchNetworkSettings()
        shape = self.settings.topology
        self.first = nn.Conv2d(3 if shape.input == "colour" else 1, shape.k1, shape.size1)
        self.second = nn.Conv2d(shape.k1, shape.k2, shape.size2)
        self.last = nn.Conv2d(shape.k2, CLASSES, shape.size3)
        table = connection_table(shape.k1, shape.k2, shape.connections)
        self.register_buffer("table", table[:, :, None, None].float(), persistent=False)
        with torch.no_grad():  # as strong a start as a kernel has that sees all maps
            self.second.weight.mul_((shape.k1 / table.sum(1)).sqrt()[:, None, None, None])

    def forward(self, patches: Tensor) -> Tensor:
        """Potentials (n,3) in [0,1] of normalised patches (n,3,P,P)."""
        shape = self.settings.topology
        pool = F.avg_pool2d if shape.pooling == "mean" else F.max_pool2d
        maps = pool(self.first(self._seen(patches)).tanh(), 2)
        maps = F.conv2d(maps, self.second.weight * self.table, self.second.bias).tanh()
        if shape.subsamplings == 2:
            maps = pool(maps, 2)
        return self._squashed(self.last(maps)).flatten(1)

    def dense(self, pixels: Tensor) -> Tensor:
        """Potentials (…,3,H,W) for each pixel of normalised images (…,3,H,W).

        Equal to ``forward`` on the patch around each pixel, computed once for all: subsampling
        keeps every place, and later steps take neighbours twice as far apart instead (Giusti et
        al., "Fast Image Scanning with Deep Max-Pooling Convolutional Neural Networks", ICIP 2013,
        in its dilated form). Past the border the image is reflected.
        """
        shape = self.settings.topology
        maps = self._seen(reflected(pixels, shape.patch))
        maps = _pooled_everywhere(self.first(maps).tanh(), 1, shape.pooling)
        maps = F.conv2d(maps, self.second.weight * self.table, self.second.bias, dilation=2).tanh()
        if shape.subsamplings == 2:
            maps = _pooled_everywhere(maps, 2, shape.pooling)
        maps = F.conv2d(maps, self.last.weight, self.last.bias, dilation=shape.stride)
        return self._squashed(maps)

    @torch.no_grad()
    def potentials(self, image: Tensor) -> Tensor:
        """Potentials (3,H,W) for each pixel of an image (3,H,W) in [0,1], at its own size."""
        pixels = normalise(image, self.settings.normalisation).pixels
        return self.dense(pixels.to(self.first.weight)).to(image)

    def _seen(self, pixels: Tensor) -> Tensor:
        """The first layer's input of pixels (…,3,H,W): the same, or (…,1,H,W) of their luma."""
        if self.settings.topology.input == "colour":
            return pixels
        return plane(pixels, "grey").unsqueeze(-3)

    def _squashed(self, scores: Tensor) -> Tensor:
        if self.settings.topology.potentials == "softmax":
            return scores.softmax(-3)
        return scores.sigmoid()


def connection_table(k1: int, k2: int, connections: int) -> Tensor:
    """Which of k1 maps each of k2 second kernels sees, bool (k2,k1); 0 connections: all.

    P2, Fig. 2, speaks of "the number of kernel combinations between layers" and prints no
    table. Ours: kernel i sees the maps i, i+1, … modulo k1, so that every map is seen as often
    as any other, or once more.
    """
    apart = (torch.arange(k1) - torch.arange(k2)[:, None]).remainder(k1)
    return apart < (connections or k1)


def reflected(pixels: Tensor, patch: int) -> Tensor:
    """Pixels (…,H,W) with a frame, so that each has its patch: patch/2 before, one less behind.

    They are reflected at the outermost pixels, as often as it takes; a single row is repeated.
    """
    for axis in (-2, -1):
        length = pixels.shape[axis]
        place = torch.arange(-(patch // 2), length + patch - patch // 2 - 1, device=pixels.device)
        last = torch.full_like(place, length - 1)  # a tensor, as is the length in an exported graph
        period = (2 * last).clamp_min(1)
        place = place.remainder(period)
        pixels = pixels.index_select(
            axis, torch.minimum(torch.minimum(place, period - place), last)
        )
    return pixels


def _pooled_everywhere(maps: Tensor, apart: int, pooling: str) -> Tensor:
    """2×2 subsampling (B,C,H,W) begun at every place, of values that are ``apart`` pixels apart."""
    for axis in (-2, -1):
        length = maps.shape[axis] - apart
        first, second = maps.narrow(axis, 0, length), maps.narrow(axis, apart, length)
        maps = (first + second) / 2 if pooling == "mean" else torch.maximum(first, second)
    return maps
