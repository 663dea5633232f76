"""The two borders of the road, rays from the vanishing point (Kong et al., 2010).

A border is a ray along which texture runs, with different colours on its two sides. Angles as in
``orientation``; rays point down, between 0 (right) and 180 (left).
"""

from dataclasses import dataclass

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.settings import Settings
from roadtorch.vanishing.voting import angle_between

BIN = 5
"""Degrees between rays."""

MIN_ANGLE = 20
"""Degrees between a ray and the horizon, and between the two borders, at least."""

CANDIDATES = torch.arange(MIN_ANGLE, 180 - MIN_ANGLE + 1, BIN)
"""The rays, 29 angles in degrees."""

POINTS = 4
"""Pixels between the points of the first border that may be the vanishing point in its stead."""

BEST = 8
"""Rays by the sum of whose OCRs the vanishing point is moved."""


class BorderSettings(Settings):
    """What a border is."""

    tolerance: float = Field(
        default=10.0, gt=0, le=90, description="degrees by which texture along a ray may miss it"
    )
    side: int = Field(
        default=4, ge=1, le=18, description="width of the region beside a ray, in steps of 5°"
    )
    length: float = Field(
        default=1 / 3, ge=0, le=1, description="of a border in the picture at least, in heights"
    )


@dataclass(frozen=True)
class Borders:
    """Where the borders meet (2,), row and column in pixels, and their angles in degrees."""

    point: Tensor
    first: int
    second: int


def consistency(points: Tensor, orientation: Tensor, settings: BorderSettings) -> Tensor:
    """Kong et al.'s OCR, (k,29) in [0,1]: the share of a ray along which texture runs.

    Of the rays from points (k,2); 0 for rays that are too short. orientation: (H,W), degrees.
    """
    height, width = orientation.shape
    turn = CANDIDATES.to(orientation).deg2rad()
    steps = torch.arange(1, height + width, device=orientation.device).to(orientation)
    row = (points[:, 0, None, None] + steps * turn.sin()[:, None]).round().long()
    column = (points[:, 1, None, None] + steps * turn.cos()[:, None]).round().long()
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    seen = orientation[row.clamp(0, height - 1), column.clamp(0, width - 1)]
    along = angle_between(seen, CANDIDATES.to(orientation)[:, None]) <= settings.tolerance
    count = inside.sum(-1)
    share = (along & inside).sum(-1) / count.clamp_min(1)
    return share.where(count >= settings.length * height, 0)


def angles_from(point: Tensor, size: tuple[int, int]) -> Tensor:
    """Degrees in (-180,180] at which a picture's pixels lie from a point (2,): (H,W)."""
    down = torch.arange(size[0], device=point.device)[:, None] - point[0]
    right = torch.arange(size[1], device=point.device) - point[1]
    return torch.atan2(down, right).rad2deg()


def colour_difference(image: Tensor, point: Tensor, settings: BorderSettings) -> Tensor:
    """How far the colours on the two sides of each ray differ, (29,) ≥ 0.

    |difference of means| / sqrt(sum of variances), of the channel in which it is greatest (Kong
    et al.). image: (3,H,W). 0 where a side has no pixels.
    """
    angle = angles_from(point, (image.shape[1], image.shape[2])).reshape(-1)
    below = (angle >= 0) & (angle < 180)
    place = (angle[below] / BIN).long()
    values = image.flatten(1)[:, below].double()
    table = torch.cat([torch.ones_like(values[:1]), values, values.square()])
    sums = torch.zeros(7, 180 // BIN, dtype=torch.float64, device=image.device)
    total = sums.index_add_(1, place, table).cumsum(1)
    total = torch.cat([torch.zeros_like(total[:, :1]), total], 1)
    ray = (CANDIDATES // BIN).to(image.device)
    low, high = (ray - settings.side).clamp_min(0), (ray + settings.side).clamp_max(180 // BIN)
    one, two = total[:, ray] - total[:, low], total[:, high] - total[:, ray]
    (mean_one, spread_one), (mean_two, spread_two) = side_moments(one), side_moments(two)
    far = (mean_one - mean_two).abs() / (spread_one + spread_two + 1e-6).sqrt()
    return far.amax(0).where((one[0] > 0) & (two[0] > 0), 0)


def side_moments(sums: Tensor) -> tuple[Tensor, Tensor]:
    """Means and variances (3,k) of counts, sums and sums of squares (7,k)."""
    count = sums[0].clamp_min(1)
    mean = sums[1:4] / count
    return mean, (sums[4:] / count - mean.square()).clamp_min(0)


def border_strength(
    image: Tensor, orientation: Tensor, point: Tensor, settings: BorderSettings
) -> Tensor:
    """How much each ray from a point (2,) is a border, (29,) ≥ 0.

    Colour difference times the OCR of the ray and its two neighbours together.
    """
    runs = consistency(point[None], orientation, settings)[0]
    three = torch.nn.functional.avg_pool1d(runs[None], 3, 1, 1, count_include_pad=True)[0] * 3
    strength = colour_difference(image, point, settings) * three
    return strength.where(runs > 0, 0)


def find_borders(
    image: Tensor, orientation: Tensor, point: Tensor, settings: BorderSettings
) -> Borders:
    """The first border, the vanishing point moved along it, and the second border from there.

    image: (3,H,W); orientation: (H,W), degrees; point: (2,), the voted vanishing point. The point
    moves to where the greatest OCRs of the other rays are most together.
    """
    first = CANDIDATES[int(border_strength(image, orientation, point, settings).argmax())]
    far = angle_between(CANDIDATES, first) > MIN_ANGLE
    turn = first.deg2rad()
    steps = torch.arange(0, image.shape[1], POINTS, device=point.device)[:, None]
    points = point + steps * torch.stack([turn.sin(), turn.cos()]).to(point)
    points = points[
        (points[:, 0] < image.shape[1]) & (points[:, 1] >= 0) & (points[:, 1] < image.shape[2])
    ]
    runs = consistency(points, orientation, settings)[:, far]
    moved = points[int(runs.topk(BEST).values.sum(1).argmax())]
    strength = border_strength(image, orientation, moved, settings)
    second = CANDIDATES[far][int(strength[far].argmax())]
    return Borders(moved, int(first), int(second))


def road_between(borders: Borders, size: tuple[int, int]) -> Tensor:
    """The pixels below the point and between the borders, bool (H,W)."""
    angle = angles_from(borders.point, size)
    low, high = sorted((borders.first, borders.second))
    return (angle >= low) & (angle <= high)
