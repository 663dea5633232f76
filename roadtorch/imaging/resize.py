"""The size at which detectors think, and the way back to the size of the image.

Sizes are known only at run time in an exported graph, which holds neither OpenCV nor NumPy. There
maps are resized by whole matrix products, not by the operator for it: ONNX Runtime's averages as
torch does, OpenVINO's reads the same file and does not (up to 0.45 off in a trial).
"""

from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.image_cache import cached_per_image
from roadtorch.base.settings import Settings

SHORTEST = 16  # pixels that a long, thin image keeps on its short side

LONGEST = 10**9  # pixels; a graph has to know a bound

ROWS, COLUMNS = 32, 64
"""Old rows and columns that one matrix product averages, about: narrow, and not too small."""


class WorkingSize(Settings):
    """How large an image is when it is analysed; smaller ones stay as they are."""

    pixels: int = Field(
        default=320 * 240,
        ge=SHORTEST**2,
        le=10**9,
        description="pixels at most: 320x240, which Álvarez 2012 names for its times alone",
    )


def working_size(height: int, width: int, working: WorkingSize) -> tuple[int, int]:
    """Height and width at which an image is analysed: its shape, at most ``working.pixels``."""
    scale = (working.pixels / (side(height) * side(width))).sqrt().clamp(max=1.0)
    return whole(side(height) * scale), whole(side(width) * scale)


def side(pixels: int) -> Tensor:
    """The length of a side as a scalar, with which a graph can compute."""
    return torch.scalar_tensor(pixels, dtype=torch.float64)


def whole(length: Tensor, least: int = SHORTEST) -> int:
    """A length, a scalar, in whole pixels, ``least`` or more."""
    pixels: Any = length.round().clamp(min=least).to(torch.int64).item()
    torch._check(pixels >= least)
    torch._check(pixels <= LONGEST)
    return pixels


@cached_per_image
def at_work(image: Tensor, working: WorkingSize) -> Tensor:
    """The image (3,H,W) as it is analysed: at its working size, in [0,1]."""
    return resized(image, working_size(*size_of(image), working)).clamp(0, 1)


def size_of(maps: Tensor) -> tuple[int, int]:
    """Rows and columns of maps (…,H,W)."""
    return maps.shape[-2], maps.shape[-1]


def resized(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Maps (…,H,W), floating point, at another size: averaged or bilinear."""
    before = size_of(maps)
    if torch.compiler.is_exporting():
        rows, columns = (averaging(*sides) for sides in zip(before, size, strict=True))
        return rows @ maps @ columns.mT
    if before == tuple(size):
        return maps
    if maps.device.type == "cpu" and maps.dtype == torch.float32 and not maps.requires_grad:
        # Faster than by torch.
        larger = size[0] >= before[0] and size[1] >= before[1]
        flat = maps.reshape(-1, *before)
        resampled = _enlarged(flat, size) if larger else _averaged(flat, size)
        return resampled.reshape(*maps.shape[:-2], *size)
    batch = maps.reshape(1, -1, *maps.shape[-2:])
    batch = F.interpolate(batch, size=size, mode="bilinear", antialias=True)
    return batch.reshape(*maps.shape[:-2], *size)


def _enlarged(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Maps (N,H,W) by OpenCV, which enlarges four to eight times faster: equal but for rounding."""
    large = np.empty((len(maps), *size), dtype=np.float32)
    for plane, target in zip(maps.numpy(), large, strict=True):
        cv2.resize(plane, size[::-1], dst=target, interpolation=cv2.INTER_LINEAR)
    return torch.from_numpy(large)


def _averaged(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Maps (N,H,W) averaged by matrix products, twice as fast: equal but for rounding."""
    count, height, width = maps.shape
    rows = maps.new_empty(count, size[0], width)
    for band in averaging_bands(height, size[0], ROWS):
        weights = band.weights.expand(count, -1, -1)
        torch.bmm(weights, maps[:, band.before], out=rows[:, band.after])
    averaged = maps.new_empty(count * size[0], size[1])
    flat = rows.reshape(-1, width)
    for band in averaging_bands(width, size[1], COLUMNS):
        torch.mm(flat[:, band.before], band.weights.T, out=averaged[:, band.after])
    return averaged.reshape(count, *size)


class Band(NamedTuple):
    """Some new pixels of a side, the old ones they are made of, and the weights (new,old)."""

    after: slice
    before: slice
    weights: Tensor


@lru_cache(maxsize=256)  # an image of another size asks for eight
@torch.inference_mode(False)  # kept for callers in any mode
def averaging_bands(before: int, after: int, old: int) -> tuple[Band, ...]:
    """How a side of ``before`` pixels becomes one of ``after``; about ``old`` of them in a band."""
    scale = before / after
    reach = max(scale, 1.0)
    most = max(1, round(old / scale))
    bands = []
    for start in range(0, after, most):
        centre = (torch.arange(start, min(start + most, after), dtype=torch.float64) + 0.5) * scale
        low = max(0, int(centre[0] - reach))
        high = min(before, int(centre[-1] + reach) + 1)
        weights = triangles(torch.arange(low, high), centre, reach).to(torch.float32)
        bands.append(Band(slice(start, start + len(centre)), slice(low, high), weights))
    return tuple(bands)


def averaging(before: int, after: int) -> Tensor:
    """The same as one matrix (after,before), for sides that a graph knows at run time."""
    scale = (side(before) / side(after)).to(torch.float32)
    centre = (torch.arange(after) + 0.5) * scale
    return triangles(torch.arange(before), centre, scale.clamp(min=1.0))


def triangles(pixels: Tensor, centre: Tensor, reach: Tensor | float) -> Tensor:
    """Weights (new,old) of old pixels (old,) in new ones, whose centres (new,) are among them.

    Around each centre lies a triangle two pixels wide, old or new ones, whichever are wider, over
    its sum: Pillow's and torch's antialiased bilinear filter.
    """
    away = (pixels + 0.5 - centre[:, None]).abs()
    triangle = (1 - away / reach).clamp_min(0)
    return triangle / triangle.sum(1, keepdim=True)


def at_image_size(cue: Tensor, size: tuple[int, int]) -> Tensor:
    """A cue (…,H,W) at the image's own size: values smoothly, labels and masks by pixels."""
    if torch.compiler.is_exporting() and not cue.is_floating_point():
        for axis in (-2, -1):
            place = torch.arange(size[axis]) * cue.shape[axis] // size[axis]
            cue = cue.index_select(axis, place)
        return cue
    if cue.is_floating_point() or size_of(cue) == tuple(size):
        return resized(cue, size)
    pixels = cue.cpu().numpy()
    if not pixels.any():
        return cue.new_zeros((*cue.shape[:-2], *size))
    rows, columns = (
        np.arange(after) * before // after
        for after, before in zip(size, cue.shape[-2:], strict=True)
    )
    # NumPy picks from labels and masks faster than torch; the fewer pixels go first.
    steps = [(rows, -2), (columns, -1)]
    for places, axis in steps if size[0] < cue.shape[-2] else reversed(steps):
        pixels = pixels.take(places, axis)
    return torch.from_numpy(pixels).to(cue.device)
