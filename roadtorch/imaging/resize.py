"""Resizing: to the working size of a detector, and back to the size of the image."""

import re
from functools import lru_cache

import cv2
import numpy as np
import torch
from pydantic import Field, field_validator
from scipy.sparse import block_diag, csr_array
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.image_cache import cached_per_image
from roadtorch.base.settings import Settings
from roadtorch.base.twins import has_twin

SHORTEST = 16  # pixels: least side of an analysed image


class WorkingSize(Settings):
    """Size at which an image is analysed; smaller images keep theirs."""

    pixels: int = Field(
        default=320 * 240,
        ge=SHORTEST**2,
        le=10**9,
        description="largest number of pixels, or WIDTHxHEIGHT (320x240: as Álvarez 2012 timed)",
    )

    @field_validator("pixels", mode="before")
    @classmethod
    def _multiply_sides(cls, value: object) -> object:
        sides = re.fullmatch(r"(\d{1,9})x(\d{1,9})", value) if isinstance(value, str) else None
        return int(sides[1]) * int(sides[2]) if sides else value


def working_size(height: int, width: int, working: WorkingSize) -> tuple[int, int]:
    """Return height and width to analyse an image at: its aspect, at most ``working.pixels``."""
    scale = (working.pixels / (side_length(height) * side_length(width))).sqrt().clamp(max=1.0)
    return round_to_pixels(side_length(height) * scale), round_to_pixels(side_length(width) * scale)


def side_length(pixels: int) -> Tensor:
    """Return the length of a side as a float64 scalar tensor, which an exported graph traces."""
    return torch.scalar_tensor(pixels, dtype=torch.float64)


@has_twin
def round_to_pixels(length: Tensor, least: int = SHORTEST) -> int:
    """Round a length, a scalar tensor, to whole pixels, ``least`` or more."""
    return int(length.round().clamp(min=least))


@cached_per_image
def resize_to_work(image: Tensor, working: WorkingSize) -> Tensor:
    """Resize an image (3, H, W) to its working size; values stay in [0, 1]."""
    return resize_maps(image, working_size(*spatial_size(image), working)).clamp(0, 1)


def spatial_size(maps: Tensor) -> tuple[int, int]:
    """Return height and width of maps (…, H, W)."""
    return maps.shape[-2], maps.shape[-1]


@has_twin
def resize_maps(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize floating-point maps (…, H, W), bilinear with antialiasing."""
    old_size = spatial_size(maps)
    if old_size == tuple(size):
        return maps
    if maps.device.type == "cpu" and maps.dtype == torch.float32 and not maps.requires_grad:
        is_larger = size[0] >= old_size[0] and size[1] >= old_size[1]
        flat = maps.reshape(-1, *old_size)
        resampled = _enlarge(flat, size) if is_larger else _shrink(flat, size)  # faster than torch
        return resampled.reshape(*maps.shape[:-2], *size)
    batch = maps.reshape(1, -1, *maps.shape[-2:])
    batch = F.interpolate(batch, size=size, mode="bilinear", antialias=True)
    return batch.reshape(*maps.shape[:-2], *size)


def _enlarge(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Enlarge maps (N, H, W) by OpenCV: torch's result but for rounding, 4 to 8 times as fast."""
    large = np.empty((len(maps), *size), dtype=np.float32)
    for plane, target in zip(maps.numpy(), large, strict=True):
        cv2.resize(plane, size[::-1], dst=target, interpolation=cv2.INTER_LINEAR)
    return torch.from_numpy(large)


def _shrink(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Shrink maps (N, H, W) by sparse matrices: torch's but for rounding, 2 to 4 times as fast."""
    count, height, width = maps.shape
    rows = sparse_matrix(height, size[0], count) @ maps.reshape(-1, width).numpy()
    columns = sparse_matrix(width, size[1]) @ cv2.transpose(rows)
    return torch.from_numpy(cv2.transpose(columns)).reshape(count, *size)


@lru_cache(maxsize=256)  # an image of a new size needs a dozen
def sparse_matrix(inputs: int, outputs: int, count: int = 1) -> csr_array:
    """Return the matrix (count · out, count · in) that resizes a side of ``count`` stacked maps."""
    support = max(inputs / outputs, 1.0)
    centre = (torch.arange(outputs, dtype=torch.float64) + 0.5) * (inputs / outputs)
    taps = min(inputs, int(2 * support) + 2)
    first = (centre - support).to(torch.int64).clamp(0, inputs - taps)
    pixels = first[:, None] + torch.arange(taps)
    weights = triangle_weights(pixels, centre, support).to(torch.float32)
    rows = np.arange(outputs + 1) * taps
    entries = weights.numpy().ravel(), pixels.numpy().ravel(), rows
    matrix = csr_array(entries, shape=(outputs, inputs))
    matrix.eliminate_zeros()
    return csr_array(block_diag([matrix] * count))


def triangle_weights(pixels: Tensor, centre: Tensor, support: Tensor | float) -> Tensor:
    """Return the weights (out, in) of pixels, (in,) or (out, in), for outputs with centres (out,).

    A triangle ``support`` wide on either side of each centre, of sum 1: the antialiased bilinear
    filter of Pillow and torch.
    """
    distance = (pixels + 0.5 - centre[:, None]).abs()
    triangle = (1 - distance / support).clamp_min(0)
    return triangle / triangle.sum(1, keepdim=True)


@has_twin
def resize_to_image(cue: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize a cue (…, H, W) to the image: values bilinear, labels and masks nearest."""
    if cue.is_floating_point() or spatial_size(cue) == tuple(size):
        return resize_maps(cue, size)
    pixels = cue.cpu().numpy()
    if not pixels.any():
        return cue.new_zeros((*cue.shape[:-2], *size))
    rows, columns = (
        np.arange(new) * old // new for new, old in zip(size, cue.shape[-2:], strict=True)
    )
    # NumPy indexes labels and masks faster than torch; rows go first if they shrink.
    steps = [(rows, -2), (columns, -1)]
    for index, axis in steps if size[0] < cue.shape[-2] else reversed(steps):
        pixels = pixels.take(index, axis)
    return torch.from_numpy(pixels).to(cue.device)
