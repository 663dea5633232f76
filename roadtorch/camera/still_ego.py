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
from roadtorch.camera.vanishing_point import (
    VanishingPoint,
    crossing,
    road_lines,
    vanishing_point,
)
from roadtorch.errors import InputError
from roadtorch.imaging.resize import at_picture_size

LEAST = 0.35
"""Evidence of an edge at which a column neither gains nor loses."""

ENOUGH = 0.08
"""Evidence above LEAST, mean over all columns, from which there is an ego car."""

STEEPEST, SLOPE = 3, 0.15
"""Rows by which a path may climb in a column, and what each costs."""

NEXT_EDGE = 0.6
"""Share of the best path's evidence that an edge above must have to be the ego car's as well."""

REACH = 0.15
"""Share of the height within which an edge above belongs to the same car."""

APART = 3
"""Rows between two edges: less is the same edge, blurred."""

EARLIEST, BELOW_HORIZON = 0.6, 0.12
"""An ego car begins below this share of the height, and this far below the vanishing point."""

LOWEST = 0.02
"""Share of the height; a strip that is nowhere higher is a border of the picture, or nothing."""

ROAD_LINES = 0.45
"""Share of slanting edges that aim at the vanishing point, from which a place is road. About
.1 to .3 on bonnets, .4 to .9 on roads with lanes; chance is .16."""


class Footage(NamedTuple):
    """What frames of one camera have in common, all of the size (h,w) at which they are seen.

    lines: (2,h,w), strength of edges that aim at the vanishing point, and of all.
    """

    still: Stillness
    point: VanishingPoint
    lines: Tensor


class EdgePath(NamedTuple):
    """A row (w,) int64 in each column, h where the path is below the picture.

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
    rows = ego_rows(look_through(list(gradients(small_grey(frame, size) for frame in frames))))
    if rows is None:
        return None
    below = torch.arange(size[0])[:, None] >= rows
    return at_picture_size(below, (frames[0].shape[-2], frames[0].shape[-1]))


def look_through(found: Sequence[Tensor]) -> Footage:
    """What the gradients (2,h,w) of two or more frames say together."""
    point = vanishing_point(found)
    return Footage(stillness(found), point, road_lines(found, point))


def ego_rows(footage: Footage) -> Tensor | None:
    """The row (w,) int64 at which the ego car begins in each column, h for none; None without one.

    The best path of an edge that stays, below which no road goes on; then, as long as there is
    one nearly as good close above it, that one: a bonnet has several edges, and wipers before it.
    """
    evidence = edge_evidence(footage.still, footage.point)
    height, row = len(evidence), torch.arange(len(evidence))[:, None]
    best = best_path(evidence)
    while best.evidence >= ENOUGH and _is_road(footage.lines, row >= best.rows + APART):
        # A reflection in the windscreen, or the road's own texture: look further down.
        best = best_path(evidence * (row > best.rows + APART))
    if best.evidence < ENOUGH:
        return None
    rows = best.rows
    while (above := _edge_above(footage.lines, evidence, rows, best.evidence)) is not None:
        rows = above
    return rows if height - int(rows.min()) >= LOWEST * height else None


def _edge_above(lines: Tensor, evidence: Tensor, rows: Tensor, enough: float) -> Tensor | None:
    """The rows (w,) of an edge close above that is the ego car's too; None where there is none."""
    height, row = len(evidence), torch.arange(len(evidence))[:, None]
    close = (row < rows - APART) & (row >= rows - REACH * height)
    above = best_path(evidence * close)
    if above.evidence < max(ENOUGH, NEXT_EDGE * enough):
        return None
    higher = torch.minimum(rows, above.rows)
    return None if _is_road(lines, (row >= higher + APART) & (row < rows - APART)) else higher


def _is_road(lines: Tensor, where: Tensor) -> bool:
    """Whether the edges of a place bool (h,w) aim at the vanishing point."""
    aiming, every = (float(strength[where].sum()) for strength in lines)
    return aiming > ROAD_LINES * every


def edge_evidence(still: Stillness, point: VanishingPoint) -> Tensor:
    """Where an edge stays that is no line of the road: (h,w) in [0,1]."""
    direction = still.direction
    evidence = still.coherence * crossing(direction, point) * direction[1].abs()
    height = len(evidence)
    evidence[: round(max(EARLIEST, point.row + BELOW_HORIZON) * height)] = 0
    return F.max_pool2d(evidence[None, None], (3, 1), 1, (1, 0))[0, 0]


def best_path(evidence: Tensor) -> EdgePath:
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
    return EdgePath(torch.tensor(rows[::-1]), float(total.max()) / width)
