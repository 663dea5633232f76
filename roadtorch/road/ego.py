"""The ego car: pixels of the vehicle that carries the camera, never road and never seed.

It is told by hand or by a camera's file (see ``Ego``). Before a detector looks at an image, the
ground above the ego car is continued over it, so that whatever is learned or counted at the
bottom of the image is ground.
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
from roadtorch.imaging.levels import above
from roadtorch.imaging.resize import side

MIN_FREE = 0.1  # share of the image that an ego car must leave free

STRIP = 0.08
"""Share of the image's side that is mirrored at most: near ground, never the sky above it."""

MIN_MEAN, PER_SHARE = 0.7, 0.5
"""Mean potential from which an ego car is one, and what is added for its share of the image:
lines near the lower edge are half believed, bonnets mostly not, and more ground lost by mistake
needs more certainty (train/README.md, "The ego car's edge")."""

SOLID = 0.6  # share of the pixels below that must be ego car

HINT = f"leave at least {MIN_FREE:.0%} of the image free"

Row = Annotated[float, Field(ge=0, le=1)]


class Ego(Settings):
    """Where the ego car is in every image, in up to three ways; what any of them says counts."""

    bottom: float = Field(
        default=0, ge=0, le=1 - MIN_FREE, description="share of the height, at the bottom"
    )
    mask: str = Field(
        default="", description="image file of the same size as the images; black is no ego car"
    )
    outline: tuple[Row, ...] = Field(
        default=(),
        strict=False,
        description="where it begins in equally wide columns: share of the height, 1 is nowhere",
    )

    @field_validator("outline")
    @classmethod
    def _leaves_something(cls, outline: tuple[float, ...]) -> tuple[float, ...]:
        if outline and sum(outline) < MIN_FREE * len(outline):
            raise ValueError(f"{HINT}: these rows cover nearly all")
        return outline


def is_given(ego: Ego) -> bool:
    """Whether the settings say that there is an ego car at all."""
    return ego != Ego()


def read_ego_mask(path: str) -> Tensor:
    """The ego car bool (H,W) in an image file: what is not black.

    Raises InputError when it cannot be read, ConfigError when it covers nearly everything.
    """
    mask = read_image(Path(path)).amax(0) > 0
    if float((~mask).double().mean()) < MIN_FREE:
        raise ConfigError(path, "covers nearly everything with ego car", HINT)
    return mask


@cached_per_image
def ego_car(image: Tensor, ego: Ego, mask: Tensor | None = None) -> Tensor:
    """The ego car bool (H,W) in an image (3,H,W), by all that the settings say.

    mask: what ``read_ego_mask`` gave of the settings' file, for those who see many images; it
    is read where it is not given. Raises InputError when the mask has another size than the
    image, or when too little is free.
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
            problem = f"is {width}×{height} pixels, the ego mask {ego.mask} {size}"
            raise InputError("image", problem, "give a mask of the images' size")
        car = car | mask.to(image.device)
    if float((~car).double().mean()) < MIN_FREE:
        raise InputError("image", "is covered nearly everywhere by the ego car", HINT)
    return car


def outline_rows(outline: tuple[float, ...], width: int) -> Tensor:
    """Where the ego car begins in each of ``width`` columns: shares of the height (width,).

    The outline's values hold in the middle of its equally wide columns; straight lines between.
    """
    at = (np.arange(width) + 0.5) / width * len(outline) - 0.5
    return torch.from_numpy(np.interp(at, np.arange(len(outline)), outline)).float()


def is_anywhere(ego: Tensor) -> bool:
    """Whether an ego car bool (H,W) has a pixel; torch takes thirty times as long for it.

    An exported graph cannot branch on it, and reckons with one.
    """
    return torch.compiler.is_exporting() or bool(ego.cpu().numpy().any())


# --- found in the image ---------------------------------------------------------------


def ego_found(potential: Tensor) -> Tensor:
    """The ego car bool (…,H,W) by its potential (…,H,W) in [0,1]: what goes to the lower edge.

    In each column it begins at the first row from which on at least ``SOLID`` of all pixels
    are likelier ego car than not: light on a bonnet leaves no hole in it, and a car ahead
    is none. Nor is there one where next to nothing would be left free, or where it is
    only half believed.
    """
    height, width = potential.shape[-2:]
    ego = above(potential, 0.5)
    if not is_anywhere(ego):
        return ego
    below = ego.flip(-2).cumsum(-2, dtype=torch.int32).flip(-2)
    left = torch.arange(height, 0, -1, device=ego.device)[:, None]
    car = (ego & (below >= SOLID * left)).cumsum(-2, dtype=torch.int32) > 0
    size = car.sum((-2, -1), keepdim=True)
    share = size / (height * width)
    mean = (potential * car).sum((-2, -1), keepdim=True) / size.clamp(min=1)
    return car & (share <= 1 - MIN_FREE) & (mean >= MIN_MEAN + PER_SHARE * share)


# --- ground in its place ----------------------------------------------------------------


@cached_per_image
def continued(maps: Tensor, ego: Tensor) -> Tensor:
    """Maps (…,H,W) with the ego car bool (H,W) replaced by what lies above it; a new tensor.

    Column by column, a strip just above the ego car is mirrored downwards, again and again.
    What has nothing above (a mirror hung at the top) is continued from below, and columns
    that are all ego car from beside. At least one pixel must be free.
    """
    if torch.compiler.is_exporting():
        return _mirrored_down(maps, ego)
    ground, left = maps.reshape(-1, *ego.shape), ego
    for flipped, turned in ((False, False), (True, False), (False, True), (True, True)):
        if not is_anywhere(left):
            break
        ground, left = (part.mT if turned else part for part in (ground, left))
        ground, left = (part.flip(-2) if flipped else part for part in (ground, left))
        ground, left = _continued_down(ground, left)
        ground, left = (part.flip(-2) if flipped else part for part in (ground, left))
        ground, left = (part.mT if turned else part for part in (ground, left))
    return ground.reshape(maps.shape).contiguous()


def _continued_down(maps: Tensor, ego: Tensor) -> tuple[Tensor, Tensor]:
    """Maps (C,H,W) continued downwards over ego (H,W), and the ego that has nothing above it.

    Only rows from the one above the highest ego car on are looked at.
    """
    height, width = ego.shape
    car = ego.cpu().numpy()
    first = max(int(car.any(1).argmax()) - 1, 0)
    car, rows = car[first:], np.arange(first, height)[:, None]
    free = np.maximum.accumulate(np.where(car, -1, rows), 0)
    last = np.maximum.accumulate(np.where(car, rows, -1), 0)
    above = np.maximum(free, first)
    run = above - np.take_along_axis(last, above - first, 0)
    run = run.clip(1, max(1, round(STRIP * height)))
    step = (rows - above - 1).clip(0) % (2 * run)
    source = np.where(car & (free >= 0), above - np.minimum(step, 2 * run - 1 - step), rows)
    place = torch.from_numpy((source * width + np.arange(width)).reshape(-1)).to(maps.device)
    ground, hidden = maps.clone(), torch.zeros_like(ego)
    ground[:, first:] = maps.flatten(1).index_select(1, place).view(len(maps), -1, width)
    hidden[first:] = torch.from_numpy(car & (free < 0)).to(ego.device)
    return ground, hidden


def _mirrored_down(maps: Tensor, ego: Tensor) -> Tensor:
    """The same of maps (N,C,H,W) in a graph, for an ego car (N,H,W) down to the lower edge."""
    height = maps.shape[-2]
    rows = torch.arange(height)[:, None]
    first = height - ego.to(torch.int64).sum(1, keepdim=True)
    strip = (side(height) * STRIP).round().to(torch.int64).clamp(min=1)
    run = first.minimum(strip).clamp(min=1)
    step = (rows - first).clamp(min=0) % (2 * run)
    source = (first - 1 - step.minimum(2 * run - 1 - step)).clamp(min=0)
    source = torch.where(ego, source, rows)
    return maps.gather(2, source[:, None].expand(-1, maps.shape[1], -1, -1))
