"""Where the lines of the road meet: the vanishing point of a camera, and with it the horizon.

Lane marks, kerbs, rails and the feet of houses run ahead, and their pictures meet in a point on
the horizon. Each frame's strong gradients vote for the points that their edges aim at; over
many frames the votes of one camera add up. Ours, after Kong, Audibert and Ponce, "Vanishing
point detection for road detection" (CVPR 2009), who vote with Gabor filters in one picture.
"""

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.camera.still import softened

FAINT = 4.0
"""Grey levels over two pixels below which an edge has no sure direction."""

ROWS = tuple(0.2 + 0.025 * step for step in range(22))
"""Candidates, as shares of the height."""

COLUMNS = tuple(0.2 + 0.025 * step for step in range(25))
"""Candidates, as shares of the width."""

VOTERS = 1500
"""The strongest edges of a frame that may vote."""

AIM = 0.05
"""By how much an edge may miss (sine of the angle) until its vote has fallen to 1/e."""

DOUBT = 15
"""Votes a frame that a candidate must have beyond the others' share, so that few say little."""

PLACE, SPREAD = (0.47, 0.5), 0.12
"""Where a vanishing point tends to be, row and column, and the standard deviation of both."""


class VanishingPoint(NamedTuple):
    """Shares of the height and of the width."""

    row: float
    column: float


def vanishing_point(gradients: Iterable[Tensor]) -> VanishingPoint:
    """The point at which the edges of the frames' gradients (2,h,w) aim, left and right alike.

    The largest product of both sides' shares of aiming edges and of a Gaussian prior: a single
    long line aims at all points along it, but the other side's lines cross it in one.
    """
    rows, columns = torch.meshgrid(torch.tensor(ROWS), torch.tensor(COLUMNS), indexing="ij")
    aiming = all_votes = torch.zeros(2, rows.numel())
    frames = 0
    for gradient in gradients:
        some, every = _votes(gradient, rows.reshape(-1), columns.reshape(-1))
        aiming, all_votes, frames = aiming + some, all_votes + every, frames + 1
    share = (aiming / (all_votes + DOUBT * frames)).prod(0).reshape(rows.shape)
    away = (rows - PLACE[0]).square() + (columns - PLACE[1]).square()
    best = int((share * (-away / (2 * SPREAD**2)).exp()).argmax())
    return VanishingPoint(ROWS[best // len(COLUMNS)], COLUMNS[best % len(COLUMNS)])


def crossing(direction: Tensor, point: VanishingPoint) -> Tensor:
    """How far edges are from aiming at the vanishing point: (h,w) in [0,1], 0 along a road's lines.

    direction: unit gradients (2,h,w). The sine of the angle between edge and line of sight,
    from .15 (9°, still the road's: the point is known to a few pixels) to .35 (20°).
    """
    height, width = direction.shape[1:]
    down = torch.arange(height).view(-1, 1) - point.row * height
    right = torch.arange(width).view(1, -1) - point.column * width
    away = (right.square() + down.square()).sqrt().clamp_min(1e-6)
    sine = (direction[0] * right + direction[1] * down).abs() / away
    return ((sine - 0.15) / 0.2).clamp(0, 1)


def road_lines(gradients: Iterable[Tensor], point: VanishingPoint) -> Tensor:
    """Strength of slanting edges that aim at the vanishing point, and of all: (2,h,w), summed.

    Lanes, kerbs and rails pass through a place of the ground sooner or later; over a bonnet pass
    reflections of all directions.
    """
    total = torch.zeros(2, 1, 1)
    for gradient in gradients:
        strength = gradient.square().sum(0).sqrt()
        direction = gradient / strength.clamp_min(1e-9)
        slanting = (strength > FAINT) & (direction[0].abs() > 0.2)
        weight = softened(gradient).square().sum(0).sqrt() * slanting
        aims = crossing(direction, point) < 0.25
        total = total + torch.stack([weight * aims, weight])
    return total


def _votes(gradient: Tensor, rows: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
    """Votes (2,k) for k candidates from the left and the right of each, and how many could vote."""
    height, width = gradient.shape[1:]
    y, x, normal = _voters(gradient)
    right = x - columns[:, None] * width
    down = y - rows[:, None] * height
    away = (right.square() + down.square()).sqrt().clamp_min(1e-6)
    missed = (right * normal[0] + down * normal[1]) / away
    vote = (-(missed / AIM).square()).exp()
    may = (down > 0.04 * height) & (away > 0.1 * width)
    sides = torch.stack([may & (right < 0), may & (right > 0)]).to(vote)
    return (vote * sides).sum(2), sides.sum(2)


def _voters(gradient: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Rows, columns (m,) and normals (2,m) of strong slanting edges below the sky."""
    strength = gradient.square().sum(0).sqrt()
    slanting = (gradient[0].abs() > 0.2 * strength) & (gradient[1].abs() > 0.25 * strength)
    slanting[: round(0.3 * len(strength))] = False
    able = torch.where(slanting & (strength > 8), strength, 0).reshape(-1)
    chosen = able.sort(descending=True, stable=True).indices[:VOTERS]
    chosen = chosen[able[chosen] > 0]
    y, x = chosen // strength.shape[1], chosen % strength.shape[1]
    return y, x, gradient[:, y, x] / strength[y, x]
