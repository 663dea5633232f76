"""The ego car in the footage of one camera: what lies below an edge that never moves.

On a straight road lane marks and rails stay where they are as well, but they aim at the
vanishing point, and the upper edge of a bonnet or of a dashboard crosses such lines. The ego
car is all below the best such path across the picture, column by column. Ours.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.camera.still import Stillness, gradients, small_grey, small_size, stillness
from roadtorch.camera.vanishing_point import VanishingPoint, crossing, vanishing_point
from roadtorch.errors import InputError
from roadtorch.working_size import at_picture_size

LEAST = 0.3
"""Evidence of an edge at which a column neither gains nor loses."""

ENOUGH = 0.12
"""Evidence above LEAST, mean over all columns, from which there is an ego car."""

STEEPEST, SLOPE = 3, 0.08
"""Rows by which a path may climb in a column, and what each costs."""

NEXT_EDGE = 0.6
"""Share of the best path's evidence that an edge above must have to be the ego car's as well."""

REACH = 0.15
"""Share of the height within which an edge above belongs to the same car."""

BELOW_HORIZON = 0.12
"""Share of the height below the vanishing point where a bonnet may begin at the earliest."""


class EgoPath(NamedTuple):
    """The row (w,) int64 at which the ego car begins in each column, h where none is there.

    evidence: above LEAST, mean over the columns.
    """

    rows: Tensor
    evidence: float


def still_ego(frames: Sequence[Tensor]) -> Tensor | None:
    """The ego car in frames (3,H,W) of one camera, floating point in [0,1]: bool (H,W), or None.

    None where the camera sees none, which is common. 10 frames of different places are enough,
    more are better. The map has the size of the first frame; the others may differ in size.
    Raises InputError for fewer than two frames.
    """
    if len(frames) < 2:
        raise InputError("footage", f"is {len(frames)} frame(s)", "give 10 or more of one camera")
    size = small_size(frames)
    found = list(gradients(small_grey(frame, size) for frame in frames))
    path = ego_path(stillness(found), vanishing_point(found))
    if path is None:
        return None
    below = torch.arange(size[0])[:, None] >= path.rows
    return at_picture_size(below, (frames[0].shape[-2], frames[0].shape[-1]))


def ego_path(still: Stillness, point: VanishingPoint) -> EgoPath | None:
    """The upper edge of the ego car, or None where no path has enough evidence.

    The best path first; then, as long as there is one nearly as good close above it, that one:
    a bonnet has several edges, and wipers lie before it.
    """
    evidence = edge_evidence(still, point)
    height = len(evidence)
    best = best_path(evidence)
    if best.evidence < ENOUGH:
        return None
    rows, row = best.rows, torch.arange(height)[:, None]
    while True:
        close = (row < rows - 3) & (row >= rows - REACH * height)
        above = best_path(evidence * close)
        if above.evidence < max(ENOUGH, NEXT_EDGE * best.evidence):
            return EgoPath(rows, best.evidence)
        rows = torch.minimum(rows, above.rows)


def edge_evidence(still: Stillness, point: VanishingPoint) -> Tensor:
    """Where an edge stays that is no line of the road: (h,w) in [0,1]."""
    direction = still.direction
    evidence = still.coherence * crossing(direction, point) * direction[1].abs()
    height = len(evidence)
    evidence[: round(max(0.5, point.row + BELOW_HORIZON) * height)] = 0
    return F.max_pool2d(evidence[None, None], (3, 1), 1, (1, 0))[0, 0]


def best_path(evidence: Tensor) -> EgoPath:
    """The path across evidence (h,w) that gains most above LEAST; below the picture it is free.

    Dynamic programming over the columns.
    """
    height, width = evidence.shape
    gain = torch.cat([evidence - LEAST, evidence.new_zeros(1, width)])
    steps = torch.arange(-STEEPEST, STEEPEST + 1)
    cost = SLOPE * steps.abs()[:, None]
    total, came = gain[:, 0], []
    for column in range(1, width):
        padded = F.pad(total, (STEEPEST, STEEPEST), value=-torch.inf)
        best = (padded.unfold(0, height + 1, 1) - cost).max(0)
        total = best.values + gain[:, column]
        came.append(torch.arange(height + 1) + steps[best.indices])
    row = int(total.argmax())
    rows = [row]
    for back in reversed(came):
        rows.append(row := int(back[row]))
    return EgoPath(torch.tensor(rows[::-1]), float(total.max()) / width)
