"""Networks from bytes to maps of the picture's size, as modules that can be exported. Ours.

The steps are those of ``PictureNetwork.cues`` and of ``layout:cnn-7``, for a batch, and written
without what a graph cannot hold: branches on values, OpenCV, NumPy. That they say the same is
checked whenever something is exported (see ``parity``).

Pictures are resized by matrix products, not by the operator for it: ONNX Runtime's averages as
torch does, OpenVINO's reads the same file and does not (up to 0.45 off in a trial).
"""

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from roadtorch.detectors.fusion import RoadCalibration, calibrated
from roadtorch.imaging.color import DARKEST, STRONGEST, Exposure
from roadtorch.imaging.resize import SHORTEST, WorkingSize
from roadtorch.layout.classes import CLASSES, HORIZONTAL
from roadtorch.layout.patch_network import (
    FIXED_GAIN,
    FIXED_MEAN,
    MIN_DEVIATION,
    Normalisation,
    PatchNetwork,
)
from roadtorch.layout.picture_network import EGO, potentials_of
from roadtorch.layout.weights import WholePictureNetwork
from roadtorch.road.fusion import log_odds

MAX_SIDE = 10**5
"""Pixels of a side at most, so that sizes have a bound when a graph is made."""

OUTPUTS: Mapping[str, str] = {
    "likelihood": "float32 (N, H, W): how road-like each pixel is, 0 to 1",
    "layout": "float32 (N, 3, H, W): sky, vertical, horizontal, 0 to 1",
    "ego": "float32 (N, H, W): the vehicle that carries the camera, 0 to 1",
}
"""What graphs give, by name."""


def road_likelihood(road: Tensor, ego: Tensor, calibration: RoadCalibration) -> Tensor:
    """Likelihoods of ``fusion`` of potentials of road and ego car, in [0,1], of any shape."""
    return torch.where(ego >= 0.5, 0.0, calibrated(log_odds(road), calibration))


class WholePictures(nn.Module):
    """``cues`` of a network for whole pictures, for bytes: likelihood, layout, ego.

    place: which potential of the network is the likelihood, its road or the layout's horizontal.
    calibration: of the road's log odds; where the ego car is, there is none then.
    """

    outputs = ("likelihood", "layout", "ego")

    def __init__(
        self, network: WholePictureNetwork, place: int, calibration: RoadCalibration | None
    ) -> None:
        super().__init__()
        self.network = network
        self.place = place
        self.calibration = calibration

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Maps (N,H,W), (N,3,H,W) and (N,H,W) of pictures uint8 (N,H,W,3) RGB."""
        planes = planes_of(image)
        settings = self.network.settings
        small = averaged(planes, settings.height, settings.width).clamp(0, 1)
        scores = self.network(normalised(small, settings.normalisation))
        maps = averaged(potentials_of(scores), planes.shape[-2], planes.shape[-1]).clamp(0, 1)
        likelihood = maps[:, self.place]
        if self.calibration is not None:
            likelihood = road_likelihood(likelihood, maps[:, EGO], self.calibration)
        return likelihood, maps[:, :CLASSES], maps[:, EGO]


class EveryPixel(nn.Module):
    """``layout:cnn-7`` for bytes: likelihood, layout."""

    outputs = ("likelihood", "layout")

    def __init__(self, network: PatchNetwork, working: WorkingSize) -> None:
        super().__init__()
        self.network = network
        self.working = working

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Maps (N,H,W) and (N,3,H,W) of pictures uint8 (N,H,W,3) RGB."""
        planes = planes_of(image)
        small = averaged(planes, *size_at_work(planes, self.working)).clamp(0, 1)
        found = self.network.dense(normalised(small, self.network.settings.normalisation))
        layout = averaged(found, planes.shape[-2], planes.shape[-1])
        return layout[:, HORIZONTAL], layout


# --- before and behind the network ------------------------------------------------------


def planes_of(image: Tensor) -> Tensor:
    """Pictures uint8 (N,H,W,3) as float32 (N,3,H,W) in [0,1]."""
    return image.permute(0, 3, 1, 2).to(torch.float32) / 255


def averaged(maps: Tensor, height: int, width: int) -> Tensor:
    """Maps (N,C,H,W) at another size, as ``working_size.resized``: averaged or bilinear."""
    rows = averaging(maps.shape[-2], height)
    columns = averaging(maps.shape[-1], width)
    return rows @ maps @ columns.mT


def averaging(before: int, after: int) -> Tensor:
    """The matrix (after, before) that resizes a column of pixels.

    Each row is a triangle over its sum, around the place of its pixel and two pixels wide, old or
    new ones, whichever are wider: Pillow's and torch's antialiased bilinear filter.
    """
    scale = torch.scalar_tensor(before) / torch.scalar_tensor(after)
    centre = (torch.arange(after) + 0.5) * scale
    away = (torch.arange(before) + 0.5 - centre[:, None]).abs()
    triangle = (1 - away / scale.clamp(min=1.0)).clamp(min=0.0)
    return triangle / triangle.sum(1, keepdim=True)


def size_at_work(planes: Tensor, working: WorkingSize) -> tuple[int, int]:
    """``working_size.working_size`` of pictures (N,3,H,W) whose size is known only at run time."""
    height, width = (torch.scalar_tensor(side, dtype=torch.float64) for side in planes.shape[-2:])
    scale = (working.pixels / (height * width)).sqrt().clamp(max=1.0)
    return _length(height * scale), _length(width * scale)


def _length(side: Tensor) -> int:
    """A side, a scalar, in whole pixels, whose bounds a graph knows."""
    length: Any = side.round().clamp(min=SHORTEST).to(torch.int64).item()
    torch._check(length >= SHORTEST)
    torch._check(length <= MAX_SIDE)
    return length


def normalised(images: Tensor, normalisation: Normalisation) -> Tensor:
    """``normalisation.normalise`` for images (N,3,H,W) in [0,1]."""
    if normalisation.kind == "none":
        return images
    if normalisation.kind.startswith("brightened"):
        images = brightened_alike(images, normalisation.exposure)
    if normalisation.kind.endswith("picture"):
        apart = images - images.mean((2, 3), keepdim=True)
        deviation = apart.square().mean((1, 2, 3), keepdim=True).sqrt()
        return apart / deviation.clamp(min=MIN_DEVIATION)
    return (images - FIXED_MEAN) * FIXED_GAIN


def brightened_alike(images: Tensor, exposure: Exposure) -> Tensor:
    """``exposure.brightened`` for images (N,3,H,W) in [0,1], each by its own exponent."""
    lower = images[:, :, images.shape[-2] * 11 // 20 :].mean(1).flatten(1)
    grey = lower.sort(1).values[:, (lower.shape[1] - 1) // 2].clamp(0.01, 0.99)
    exponent = (math.log(exposure.ground) / grey.log()).clamp(STRONGEST, 1.0)[:, None, None, None]
    return torch.where(exponent == 1, images, images.clamp(min=DARKEST) ** exponent)
