"""The seed area: where road is assumed, to learn its look from, and what touches it."""

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from roadtorch.settings import Settings

FRAME = (240, 320)
"""Height and width in pixels of the frame in which a seed area is described."""


class SeedArea(Settings):
    """The rectangle at the middle of the bottom edge that is taken to be road."""

    height: float = Field(
        default=30, ge=1, le=FRAME[0], description="rows, of a frame of 240; scaled with the image"
    )
    width: float = Field(
        default=80, ge=1, le=FRAME[1], description="columns, of a frame of 320; scaled likewise"
    )


def seed_area(
    height: int, width: int, seed: SeedArea | None = None, least: int = 1
) -> tuple[slice, slice]:
    """Rows and columns of the seed area in a picture of height × width pixels.

    At the middle of the bottom edge, of at least ``least`` pixels on each side where the
    picture has them, and always inside. P2 (section 4, "the central-bottom part of the
    image"); without ``seed`` the default size.
    """
    seed = SeedArea() if seed is None else seed
    rows = min(height, max(least, round(seed.height * height / FRAME[0])))
    columns = min(width, max(least, round(seed.width * width / FRAME[1])))
    left = (width - columns) // 2
    return slice(height - rows, height), slice(left, left + columns)


def remove_isolated(mask: Tensor, rows: slice, columns: slice) -> Tensor:
    """Keep the 4-connected regions of a mask (H,W) that touch the rectangle rows × columns.

    Where none does, the mask comes back unchanged: then it says nothing about which
    region is the road. P2, section 6.2 (isolated areas are discarded).
    """
    pixels = np.ascontiguousarray(mask.cpu().numpy(), dtype=np.uint8)
    count, found = cv2.connectedComponents(pixels, connectivity=4)
    regions = np.asarray(found, dtype=np.int32)
    kept = np.zeros(count, dtype=bool)
    kept[regions[rows, columns]] = True
    kept[0] = False  # the background
    if not kept.any():
        return mask
    return torch.from_numpy(kept.take(regions)).to(mask.device)


def seed_segments(labels: Tensor, seed: SeedArea | None = None) -> Tensor:
    """Numbers of the segments of labels (H,W) that lie in the seed area: int64 (k,), k ≥ 1.

    Those that have half of their pixels in it, and always the one that fills most of it.
    """
    rows, columns = seed_area(labels.shape[0], labels.shape[1], seed)
    count = int(labels.max()) + 1
    inside = torch.bincount(labels[rows, columns].reshape(-1), minlength=count)
    size = torch.bincount(labels.reshape(-1), minlength=count)
    return ((2 * inside >= size.clamp_min(1)) | (inside == inside.max())).nonzero()[:, 0]
