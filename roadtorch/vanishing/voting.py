"""The vanishing point of one picture, by locally adaptive soft voting (Kong et al., 2010).

``camera.gradients`` has its heir for footage: it votes with gradients, over many frames.
"""

from dataclasses import dataclass

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.settings import Settings

CHUNK = 8
"""Candidates that are looked at together."""


class VotingSettings(Settings):
    """Who votes for which points."""

    confidence: float = Field(
        default=0.3, ge=0, lt=1, description="a voter's least confidence in its orientation"
    )
    radius: float = Field(
        default=0.35, gt=0, le=2, description="of the half disk below a point, in diagonals"
    )
    lowest: float = Field(
        default=0.9, gt=0, le=1, description="share of the rows, from the top, with candidates"
    )
    step: int = Field(
        default=8, ge=1, le=64, description="pixels between candidates; then all around the best"
    )
    tolerance: float = Field(
        default=5.0, gt=0, le=90, description="degrees by which a near voter may miss"
    )


@dataclass(frozen=True)
class Voters:
    """Rows and columns (m,2) of pixels that are sure of their texture, and its angles (m,)."""

    places: Tensor
    angles: Tensor
    diagonal: float


def soft_votes(points: Tensor, voters: Voters, settings: VotingSettings) -> Tensor:
    """The votes (k,) ≥ 0 that points (k,2), rows and columns in pixels, get.

    Kong et al.: a voter below a point and within the radius gives 1/(1 + (g·d)²), with g
    the degrees by which it misses the point and d their distance in diagonals, if g is at most
    5/(1 + 2d).
    """
    votes = []
    for some in points.split(CHUNK):
        down, right = (voters.places[:, way] - some[:, way, None] for way in (0, 1))
        away = (down.square() + right.square()).sqrt() / voters.diagonal
        missed = angle_between(torch.atan2(down, right).rad2deg(), voters.angles)
        may = (down > 0) & (away <= settings.radius)
        may &= missed <= settings.tolerance / (1 + 2 * away)
        votes.append((may / (1 + (missed * away).square())).sum(1))
    return torch.cat(votes)


def angle_between(one: Tensor, other: Tensor) -> Tensor:
    """Degrees in [0,90] between directions without a sense, given in degrees."""
    turned = (one - other).remainder(180)
    return torch.minimum(turned, 180 - turned)


def vote_vanishing_point(
    orientation: Tensor, confidence: Tensor, settings: VotingSettings
) -> Tensor | None:
    """The point (2,), row and column in pixels, with the most votes; None where nothing votes.

    orientation: (H,W), degrees; confidence: (H,W) in [0,1]. Kong et al. try every pixel; ours
    tries each ``step``-th and then all around the best, which is a fiftieth of the work.
    """
    height, width = orientation.shape
    sure = confidence > settings.confidence
    places = sure.nonzero().to(orientation)
    voters = Voters(places, orientation[sure], (height**2 + width**2) ** 0.5)
    last, step = max(1, round(settings.lowest * height)), settings.step
    coarse = _most_voted(range(0, last, step), range(0, width, step), voters, settings)
    if coarse is None:
        return None
    row, column = (int(place) for place in coarse)
    near = (_around(row, last, step), _around(column, width, step))
    return _most_voted(*near, voters, settings)


def _most_voted(
    rows: range, columns: range, voters: Voters, settings: VotingSettings
) -> Tensor | None:
    """The point of a grid with the most votes, the first of several; None where all have 0."""
    grid = torch.cartesian_prod(torch.tensor(rows), torch.tensor(columns)).to(voters.places)
    votes = soft_votes(grid, voters, settings)
    return grid[int(votes.argmax())] if votes.max() > 0 else None


def _around(place: int, end: int, reach: int) -> range:
    """The whole numbers from 0 to end - 1 that are less than ``reach`` from a place."""
    return range(max(0, place - reach + 1), min(end, place + reach))
