"""The ego car: pixels of the vehicle that carries the camera, never road and never seed.

It comes from the settings (``Ego``), a camera's file, or a network's map. The ground above it is
extrapolated over it: in the image before it is analysed, or in a network's maps afterwards, so that
the bottom of the image, of which the road's appearance is learned, is ground.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from pydantic import Field, field_validator
from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import read_image
from roadtorch.base.image_cache import cached_per_image
from roadtorch.base.settings import Settings
from roadtorch.base.twins import has_twin
from roadtorch.imaging.levels import is_above

MIN_FREE = 0.1  # fraction of the image that an ego car must leave free

MAX_STRIP = 0.08
"""Largest strip that is mirrored, as a fraction of the height: near ground, never the sky."""

MIN_MEAN, MEAN_PER_AREA = 0.7, 0.5
"""Least mean potential of an ego car, and its increase with the fraction of the image that the car
covers: lane markings near the lower edge get about 0.5, bonnets mostly more, and a larger mistake
loses more ground ("The ego car's edge" in train/README.md at 0ee65af)."""

MIN_FILL = 0.6  # fraction of the pixels below a column's first row that must be ego car

FREE_HINT = f"leave at least {MIN_FREE:.0%} of the image free"


class Ego(Settings):
    """Ego car of all images, described in up to three ways, of which the union counts.

    For the analysis it is filled, at full size, from the ground beside it; its likelihood is 0.
    """

    bottom: float = Field(
        default=0, ge=0, le=1 - MIN_FREE, description="fraction of the height, at the bottom"
    )
    mask: str = Field(
        default="",
        description="image file of the images' full size; pixels that are not black are ego car",
    )
    outline: tuple[Annotated[float, Field(ge=0, le=1)], ...] = Field(
        default=(),
        strict=False,
        description="first row of the ego car, fraction of the height from the top, at the centres "
        "of equally wide columns, linear between them; 1: no ego car",
    )

    @field_validator("outline")
    @classmethod
    def _check_outline(cls, outline: tuple[float, ...]) -> tuple[float, ...]:
        if outline and sum(outline) < MIN_FREE * len(outline):
            raise ValueError(f"{FREE_HINT}: these rows cover nearly all of it")
        return outline


def has_ego_car(ego: Ego) -> bool:
    """Return whether any setting of the ego car differs from its default."""
    return bool(ego.bottom or ego.mask or ego.outline)  # comparing models takes .2 ms


def read_ego_mask(path: str) -> Tensor:
    """Read an ego car mask, bool (H, W), from an image file: pixels that are not black.

    Raises InputError if it cannot be read, ConfigError if nearly every pixel is ego car.
    """
    mask = read_image(Path(path)).amax(0) > 0
    if float((~mask).double().mean()) < MIN_FREE:
        raise ConfigError(path, "marks nearly every pixel as ego car", FREE_HINT)
    return mask


@cached_per_image
def ego_car(image: Tensor, ego: Ego, mask: Tensor | None = None) -> Tensor:
    """Return the ego car that the settings describe for an image (3, H, W): bool (H, W).

    mask: that of the settings' file; None: it is read, and raises as ``read_ego_mask``. Raises
    InputError if the mask differs in size from the image, or too little is left free.
    """
    height, width = image.shape[-2:]
    rows = (torch.arange(height, device=image.device) + 0.5) / height
    car = (rows > 1 - ego.bottom)[:, None].expand(height, width)
    if ego.outline:
        car = car | (rows[:, None] > outline_rows(ego.outline, width).to(image.device))
    if ego.mask:
        mask = read_ego_mask(ego.mask) if mask is None else mask
        if mask.shape != car.shape:
            size = f"{mask.shape[1]}×{mask.shape[0]}"
            message = f"is {width}×{height} pixels, but the ego mask {ego.mask} is {size}"
            raise InputError("image", message, "give a mask of the images' size")
        car = car | mask.to(image.device)
    if float((~car).double().mean()) < MIN_FREE:
        raise InputError("image", "is almost completely covered by the ego car", FREE_HINT)
    return car


def outline_rows(outline: tuple[float, ...], width: int) -> Tensor:
    """Return the ego car's first row in each of ``width`` columns, as fractions of the height.

    The outline's values hold at the centres of its equally wide columns; linear in between.
    """
    positions = (np.arange(width) + 0.5) / width * len(outline) - 0.5
    return torch.from_numpy(np.interp(positions, np.arange(len(outline)), outline)).float()


@has_twin
def any_pixel(mask: Tensor) -> bool:
    """Return whether a bool mask has a pixel; ``Tensor.any`` takes thirty times as long."""
    return bool(mask.cpu().numpy().any())


# --- from a network's map ---------------------------------------------------------------


def find_ego_car(potential: Tensor) -> Tensor:
    """Return the ego car, bool (…, H, W), from a network's potential in [0, 1] of that shape.

    In each column it begins at the first pixel above 0.5 from which at least ``MIN_FILL`` of the
    pixels down to the lower edge exceed 0.5: reflections leave no hole, and a car ahead does not
    count. False everywhere if less than ``MIN_FREE`` would be left, or its mean potential is low.
    """
    height, width = potential.shape[-2:]
    ego = is_above(potential, 0.5)
    if not any_pixel(ego):
        return ego
    below = ego.flip(-2).cumsum(-2, dtype=torch.int32).flip(-2)
    rows_below = torch.arange(height, 0, -1, device=ego.device)[:, None]
    car = (ego & (below >= MIN_FILL * rows_below)).cumsum(-2, dtype=torch.int32) > 0
    size = car.sum((-2, -1), keepdim=True)
    fraction = size / (height * width)
    mean = (potential * car).sum((-2, -1), keepdim=True) / size.clamp(min=1)
    return car & (fraction <= 1 - MIN_FREE) & (mean >= MIN_MEAN + MEAN_PER_AREA * fraction)


# --- ground in its place ----------------------------------------------------------------


@has_twin
@cached_per_image
def extrapolate_over_ego(maps: Tensor, ego: Tensor) -> Tensor:
    """Replace the ego car, bool (H, W), in maps (…, H, W) by the ground above it; a new tensor.

    In each column a strip just above the ego car is mirrored downwards repeatedly. Pixels with
    nothing above them are filled from below, and columns that are all ego car from the side. At
    least one pixel must be free.
    """
    ground, hidden = maps.reshape(-1, *ego.shape), ego
    for flip, transpose in ((False, False), (True, False), (False, True), (True, True)):
        if not any_pixel(hidden):
            break
        ground, hidden = (part.mT if transpose else part for part in (ground, hidden))
        ground, hidden = (part.flip(-2) if flip else part for part in (ground, hidden))
        ground, hidden = _mirror_down(ground, hidden)
        ground, hidden = (part.flip(-2) if flip else part for part in (ground, hidden))
        ground, hidden = (part.mT if transpose else part for part in (ground, hidden))
    return ground.reshape(maps.shape).contiguous()


def _mirror_down(maps: Tensor, ego: Tensor) -> tuple[Tensor, Tensor]:
    """Mirror maps (C, H, W) down over the ego car (H, W); return them and the pixels not filled."""
    height, width = ego.shape
    car = ego.cpu().numpy()
    first = max(int(car.any(1).argmax()) - 1, 0)
    car, rows = car[first:], np.arange(first, height, dtype=np.int32)[:, None]
    strip = max(1, round(MAX_STRIP * height))
    if (car[:-1] <= car[1:]).all():  # it stands on the lower edge: a fifth of the time
        free = height - 1 - car.sum(0, dtype=np.int32)
        above = np.maximum(free, first)
        run = (above + 1).clip(1, strip)
    else:
        free = np.maximum.accumulate(np.where(car, np.int32(-1), rows), 0)
        last = np.maximum.accumulate(np.where(car, rows, np.int32(-1)), 0)
        above = np.maximum(free, first)
        run = (above - np.take_along_axis(last, above - first, 0)).clip(1, strip)
    step = (rows - above - 1).clip(0) % (2 * run)
    source = np.where(car & (free >= 0), above - np.minimum(step, 2 * run - 1 - step), rows)
    index = (source * width + np.arange(width, dtype=np.int32)).reshape(-1)
    ground, hidden = maps.clone(), torch.zeros_like(ego)
    lower = maps.flatten(1).index_select(1, torch.from_numpy(index).to(maps.device))
    ground[:, first:] = lower.view(len(maps), -1, width)
    hidden[first:] = torch.from_numpy(car & (free < 0)).to(ego.device)
    return ground, hidden
