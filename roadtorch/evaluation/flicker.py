"""Flicker: how often a decision about the same place changes from one frame to the next.

The mask before is carried along the motion of the picture; pixels that cannot be followed (their
round trip misses by more than a pixel, or leaves the picture) are not compared. (Ours; without
truth, after temporal consistency in Lai et al., Learning Blind Video Temporal Consistency, ECCV
2018, who compare pixels that are not occluded after warping.)
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.imaging.motion import EXACT, carried, dense_flow, flow_picture, round_trip
from roadtorch.imaging.resize import at_picture_size

MISS = 1.0  # pixels by which a round trip may miss
WIDTH = 480  # pixels of the pictures in which motion is found


class Followed(NamedTuple):
    """Where a frame's pixels were in the frame before, and which of them can be followed.

    flow: float32 (h,w,2), pixels right and down. sure: bool (h,w).
    """

    flow: Tensor
    sure: Tensor


@dataclass(frozen=True)
class Changes:
    """Pixels that were compared with the frame before, and those decided the other way."""

    changed: int
    compared: int

    def __add__(self, more: "Changes") -> "Changes":
        """The counts of both."""
        return Changes(self.changed + more.changed, self.compared + more.compared)


def followed(before: Tensor, image: Tensor) -> Followed:
    """The motion from a frame (3,H,W) in [0,1] back to the one before."""
    here, there = flow_picture(image, WIDTH), flow_picture(before, WIDTH)
    flow = dense_flow(here, there, EXACT)
    return Followed(flow, round_trip(flow, dense_flow(there, here, EXACT)) <= MISS)


def count_changes(before: Tensor, mask: Tensor, motion: Followed) -> Changes:
    """Compare a mask bool (H,W) with the one before; motion may have another size."""
    moved = carried(before.to(torch.float32), motion.flow) >= 0.5
    sure = at_picture_size(motion.sure, (mask.shape[0], mask.shape[1]))
    return Changes(int(((moved != mask) & sure).sum()), int(sure.sum()))


def flicker(changes: Iterable[Changes]) -> float:
    """Share of the compared pixels that changed, over all frames; NaN without any."""
    total = sum(changes, Changes(0, 0))
    return total.changed / total.compared if total.compared else math.nan
