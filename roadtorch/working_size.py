"""The size at which detectors think, and the way back to the size of the picture."""

from collections.abc import Callable, Iterator, Mapping

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.image_cache import cached_per_image
from roadtorch.settings import Settings

SHORTEST = 16
"""Pixels that a long, thin picture keeps on its short side."""


class WorkingSize(Settings):
    """How large a picture is when it is analysed; smaller ones stay as they are."""

    pixels: int = Field(
        default=320 * 240,
        ge=SHORTEST**2,
        le=10**9,
        description="pixels at most: 320x240, which Álvarez 2012 names for its times alone",
    )


def working_size(height: int, width: int, working: WorkingSize) -> tuple[int, int]:
    """Height and width at which a picture is analysed: its shape, at most ``working.pixels``."""
    scale = min(1.0, (working.pixels / (height * width)) ** 0.5)
    return max(SHORTEST, round(height * scale)), max(SHORTEST, round(width * scale))


@cached_per_image
def at_work(image: Tensor, working: WorkingSize) -> Tensor:
    """The image (3,H,W) as it is analysed: at its working size, in [0,1]."""
    return resized(image, working_size(image.shape[-2], image.shape[-1], working)).clamp(0, 1)


def resized(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Maps (…,H,W), floating point, at another size: averaged or bilinear."""
    before = (maps.shape[-2], maps.shape[-1])
    if before == tuple(size):
        return maps
    if size[0] >= before[0] and size[1] >= before[1] and _is_plain(maps):
        return _enlarged(maps, size)
    batch = maps.reshape(1, -1, *maps.shape[-2:])
    batch = F.interpolate(batch, size=size, mode="bilinear", antialias=True)
    return batch.reshape(*maps.shape[:-2], *size)


def _is_plain(maps: Tensor) -> bool:
    """Whether OpenCV can take maps as they are: on the CPU, float32, no gradient asked for."""
    return maps.device.type == "cpu" and maps.dtype == torch.float32 and not maps.requires_grad


def _enlarged(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """The same by OpenCV, which enlarges four to eight times faster: equal but for rounding."""
    flat = maps.reshape(-1, *maps.shape[-2:]).numpy()
    large = np.empty((len(flat), *size), dtype=np.float32)
    for plane, target in zip(flat, large, strict=True):
        cv2.resize(plane, size[::-1], dst=target, interpolation=cv2.INTER_LINEAR)
    return torch.from_numpy(large).reshape(*maps.shape[:-2], *size)


def at_picture_size(cue: Tensor, size: tuple[int, int]) -> Tensor:
    """A cue (…,H,W) at the picture's own size: values smoothly, labels and masks by pixels."""
    if cue.is_floating_point():
        return resized(cue, size)
    rows = torch.arange(size[0], device=cue.device) * cue.shape[-2] // size[0]
    columns = torch.arange(size[1], device=cue.device) * cue.shape[-1] // size[1]
    return cue.index_select(-2, rows).index_select(-1, columns)


class FullSize(Mapping[str, Tensor]):
    """Cues by name, each brought to the picture's own size when it is asked for.

    A large picture has room for the maps that are wanted, not for all that were made.
    analysed: the cues as they came.
    """

    def __init__(self, analysed: Mapping[str, Tensor], size: tuple[int, int]) -> None:
        self.analysed = analysed
        self._size = size

    def __getitem__(self, name: str) -> Tensor:
        """The cue (…,H,W) at full size; KeyError where there is none of that name."""
        return at_picture_size(self.analysed[name], self._size)

    def __iter__(self) -> Iterator[str]:
        """The names of the cues."""
        return iter(self.analysed)

    def __len__(self) -> int:
        """How many cues there are."""
        return len(self.analysed)


def at_working_size(
    analyse: Callable[[Tensor], Mapping[str, Tensor]], image: Tensor, working: WorkingSize
) -> FullSize:
    """What ``analyse`` finds in an image (3,H,W) at its working size, brought back to full size."""
    return FullSize(analyse(at_work(image, working)), (image.shape[-2], image.shape[-1]))
