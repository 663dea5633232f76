"""Road between two borders that meet in a vanishing point (Kong et al. 2010, a baseline of P1).

Kong, Audibert, Ponce, "General road detection from a single image", IEEE TIP 19(8), 2010: Gabor
filters give the texture orientation of each pixel, pixels vote for the vanishing point, and the two
borders are rays from it. Angles are in degrees, from the columns' axis towards the rows' (clockwise
in the image): 0 is along a row, 90 down a column. Rays point down, between 0 (right) and 180
(left).
"""

import math
from dataclasses import dataclass

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.settings import Settings

# --- texture orientation -------------------------------------------------------------

ENVELOPE_WAVES = 2.2
"""c of Kong et al., waves in the envelope; 2.2 is a spatial bandwidth of 1.7 octaves."""

PADDING = 24  # pixels of reflection padding, so that opposite edges do not affect each other

FIRST_RESPONSE, LAST_RESPONSE = 4, 15
"""Range of the responses, by falling size, whose mean is compared with the greatest."""

MIN_POWER = 1e-6  # least squared response, of grey from 0 to 1; below it there is only rounding


class GaborBank(Settings):
    """Settings of the Gabor filters. Kong et al. use five scales of the frequencies 2.1·2^k.

    Ours are 2.1/2^k, waves of 3, 6 and 12 pixels: the others would be shorter than a pixel, or of
    24 and 48 pixels, whose responses are so large that they alone would decide.
    """

    orientations: int = Field(default=36, ge=16, le=180, description="number, evenly over 180°")
    scales: int = Field(default=3, ge=1, le=8, description="number of scales, an octave apart")
    frequency: float = Field(
        default=2.1, gt=0, le=math.pi, description="frequency of the finest scale, radians/pixel"
    )


def filter_spectrum(size: tuple[int, int], angle: float, frequency: float) -> Tensor:
    """Return the Fourier transform (H, W) of a Gabor filter with waves along ``angle``, degrees.

    Kong et al.: w/(sqrt(2 pi) c) exp(-w²(4a² + b²)/(8c²)) (exp(iwa) - exp(-c²/2)), with a along the
    waves and b across, w = ``frequency`` in radians a pixel; it is real, and 0 at frequency 0.
    """
    down = 2 * math.pi * torch.fft.fftfreq(size[0])[:, None]
    right = 2 * math.pi * torch.fft.fftfreq(size[1])
    turn = math.radians(angle)
    along = right * math.cos(turn) + down * math.sin(turn)
    across = down * math.cos(turn) - right * math.sin(turn)
    width = ENVELOPE_WAVES / frequency
    wave = (-((width * (along - frequency)) ** 2) / 2).exp()
    offset = (-((width * along) ** 2 + ENVELOPE_WAVES**2) / 2).exp()
    gain = 2 * math.sqrt(2 * math.pi) * width
    return gain * (-((2 * width * across) ** 2) / 2).exp() * (wave - offset)


def gabor_responses(grey: Tensor, bank: GaborBank) -> Tensor:
    """Return squared magnitudes of responses to grey (H, W), (orientations, H, W).

    Averaged over scales; the i-th is for texture at i·180/orientations degrees.
    """
    height, width = grey.shape
    margin = min(PADDING, height - 1, width - 1)
    padded = F.pad(grey[None, None], (margin,) * 4, mode="reflect")[0, 0]
    spectrum = torch.fft.fft2(padded)
    size = (padded.shape[0], padded.shape[1])
    responses = []
    for step in range(bank.orientations):
        waves = 180 * step / bank.orientations + 90  # across the texture
        power = torch.zeros_like(padded)
        for scale in range(bank.scales):
            gabor = filter_spectrum(size, waves, bank.frequency / 2**scale).to(padded)
            power += torch.fft.ifft2(spectrum * gabor).abs().square()
        responses.append(power[margin : margin + height, margin : margin + width] / bank.scales)
    return torch.stack(responses)


def dominant_orientation(responses: Tensor) -> tuple[Tensor, Tensor]:
    """Return the orientation (H, W) of the greatest response in degrees, and its confidence.

    Confidence: 1 - mean(r5 … r15)/r1 of the responses by falling size (Kong et al.), scaled to span
    [0, 1] in the image; 0 everywhere in an image without texture.
    """
    falling = responses.sort(0, descending=True).values
    top = falling[0].clamp_min(torch.finfo(falling.dtype).tiny)
    confidence = (1 - falling[FIRST_RESPONSE:LAST_RESPONSE].mean(0) / top).where(
        falling[0] > MIN_POWER, 0
    )
    low, high = confidence.aminmax()
    angle = responses.argmax(0) * (180 / len(responses))
    return angle.to(responses), (confidence - low) / torch.where(high > low, high - low, 1)


# --- the vote ---------------------------------------------------------------------------

VOTE_CHUNK = 8  # candidate points whose votes are counted at a time


class VotingSettings(Settings):
    """Settings of the vote for the vanishing point."""

    confidence: float = Field(
        default=0.3, ge=0, lt=1, description="least confidence of a voter in its orientation"
    )
    radius: float = Field(
        default=0.35, gt=0, le=2, description="radius of the half disk of voters, in diagonals"
    )
    max_row: float = Field(
        default=0.9, gt=0, le=1, description="lowest candidate row, as a fraction of the height"
    )
    step: int = Field(
        default=8, ge=1, le=64, description="pixels between candidates; then 1 around the best"
    )
    tolerance: float = Field(
        default=5.0, gt=0, le=90, description="degrees by which a near voter may miss the point"
    )


def soft_votes(
    points: Tensor, positions: Tensor, angles: Tensor, diagonal: float, settings: VotingSettings
) -> Tensor:
    """Return the votes (k,) ≥ 0 for points (k, 2), rows and columns in pixels.

    Voters at ``positions`` (m, 2) have texture at ``angles`` (m,). Kong et al.: one below a point
    and within the radius gives 1/(1 + (g·d)²) if g is at most 5/(1 + 2d); g is the angle in degrees
    by which its texture misses the point, d the distance in diagonals.
    """
    votes = []
    for chunk in points.split(VOTE_CHUNK):
        down, right = (positions[:, axis] - chunk[:, axis, None] for axis in (0, 1))
        distance = (down.square() + right.square()).sqrt() / diagonal
        missed = angle_between(torch.atan2(down, right).rad2deg(), angles)
        valid = (down > 0) & (distance <= settings.radius)
        valid &= missed <= settings.tolerance / (1 + 2 * distance)
        votes.append((valid / (1 + (missed * distance).square())).sum(1))
    return torch.cat(votes)


def angle_between(first: Tensor, second: Tensor) -> Tensor:
    """Return the angle in [0, 90] between undirected lines, all in degrees."""
    turned = (first - second).remainder(180)
    return torch.minimum(turned, 180 - turned)


def vote_vanishing_point(
    orientation: Tensor, confidence: Tensor, settings: VotingSettings
) -> Tensor | None:
    """Return row and column (2,) of the point with the most votes, in pixels; None without votes.

    Kong et al. try every pixel; ours tries each ``step``-th and then all around the best, a
    fiftieth of the work. See ``camera.gradients`` for footage.

    orientation: of the texture, in degrees, shape (H, W). confidence: of the orientation, in
    [0, 1], shape (H, W).
    """
    height, width = orientation.shape
    confident = confidence > settings.confidence
    positions, angles = confident.nonzero().to(orientation), orientation[confident]

    def most_voted(rows: range, columns: range) -> Tensor | None:
        grid = torch.cartesian_prod(torch.tensor(rows), torch.tensor(columns)).to(positions)
        votes = soft_votes(grid, positions, angles, (height**2 + width**2) ** 0.5, settings)
        return grid[int(votes.argmax())] if votes.max() > 0 else None

    last, step = max(1, round(settings.max_row * height)), settings.step
    coarse = most_voted(range(0, last, step), range(0, width, step))
    if coarse is None:
        return None
    row, column = (int(position) for position in coarse)
    return most_voted(
        range(max(0, row - step + 1), min(last, row + step)),
        range(max(0, column - step + 1), min(width, column + step)),
    )


# --- the borders ------------------------------------------------------------------------

RAY_STEP = 5  # degrees between neighbouring rays
MIN_ANGLE = 20  # least angle in degrees between a ray and the horizon, and between the two borders

RAY_ANGLES = torch.arange(MIN_ANGLE, 180 - MIN_ANGLE + 1, RAY_STEP)
"""Angles of the 29 candidate rays, in degrees."""

POINT_STEP = 4  # pixels between the points of the first border that may replace the vanishing point
BEST_RAYS = 8  # number of rays whose summed OCRs move the vanishing point


class BorderSettings(Settings):
    """Settings of the road borders."""

    tolerance: float = Field(
        default=10.0, gt=0, le=90, description="degrees by which texture may deviate from a ray"
    )
    side: int = Field(
        default=4, ge=1, le=18, description="sector on each side of a ray, in steps of 5°"
    )
    length: float = Field(
        default=1 / 3, ge=0, le=1, description="least length of a border in the image, in heights"
    )


@dataclass(frozen=True, eq=False)
class Borders:
    """Road borders: their intersection (2,), row and column in pixels; their angles in degrees."""

    point: Tensor
    first: int
    second: int


def ray_consistency(points: Tensor, orientation: Tensor, settings: BorderSettings) -> Tensor:
    """Return Kong et al.'s OCR of the rays from points (k, 2), (k, 29) in [0, 1].

    The orientation consistency ratio is the fraction of a ray along which texture runs; 0 for rays
    that are too short. ``orientation`` is in degrees, (H, W).
    """
    height, width = orientation.shape
    turn = RAY_ANGLES.to(orientation).deg2rad()
    steps = torch.arange(1, height + width, device=orientation.device).to(orientation)
    row = (points[:, 0, None, None] + steps * turn.sin()[:, None]).round().long()
    column = (points[:, 1, None, None] + steps * turn.cos()[:, None]).round().long()
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    texture = orientation[row.clamp(0, height - 1), column.clamp(0, width - 1)]
    along = angle_between(texture, RAY_ANGLES.to(orientation)[:, None]) <= settings.tolerance
    count = inside.sum(-1)
    ratio = (along & inside).sum(-1) / count.clamp_min(1)
    return ratio.where(count >= settings.length * height, 0)


def pixel_angles(point: Tensor, size: tuple[int, int]) -> Tensor:
    """Return the angles (H, W) of all pixels from a point (2,), degrees in (-180, 180]."""
    down = torch.arange(size[0], device=point.device)[:, None] - point[0]
    right = torch.arange(size[1], device=point.device) - point[1]
    return torch.atan2(down, right).rad2deg()


def colour_difference(image: Tensor, point: Tensor, settings: BorderSettings) -> Tensor:
    """Return the colour difference between the two sides of each ray, (29,) ≥ 0.

    |difference of means| / sqrt(sum of variances) in the channel where it is greatest (Kong et
    al.); 0 where a side of the ray has no pixels.
    """
    angle = pixel_angles(point, (image.shape[1], image.shape[2])).reshape(-1)
    below = (angle >= 0) & (angle < 180)
    sector = (angle[below] / RAY_STEP).long()
    values = image.flatten(1)[:, below].double()
    table = torch.cat([torch.ones_like(values[:1]), values, values.square()])
    sums = torch.zeros(7, 180 // RAY_STEP, dtype=torch.float64, device=image.device)
    total = sums.index_add_(1, sector, table).cumsum(1)
    total = torch.cat([torch.zeros_like(total[:, :1]), total], 1)
    ray = (RAY_ANGLES // RAY_STEP).to(image.device)
    low, high = (ray - settings.side).clamp_min(0), (ray + settings.side).clamp_max(180 // RAY_STEP)
    sides = torch.stack([total[:, ray] - total[:, low], total[:, high] - total[:, ray]])
    count = sides[:, :1]
    moments = sides[:, 1:] / count.clamp_min(1)
    mean = moments[:, :3]
    variance = (moments[:, 3:] - mean.square()).clamp_min(0)
    difference = (mean[0] - mean[1]).abs() / (variance[0] + variance[1] + 1e-6).sqrt()
    return difference.amax(0).where((count > 0).all(0)[0], 0)


def border_strength(
    image: Tensor, orientation: Tensor, point: Tensor, settings: BorderSettings
) -> Tensor:
    """Return the strength of each ray from a point (2,) as a border, (29,) ≥ 0.

    Colour difference times the OCR of the ray and its two neighbours together.
    """
    runs = ray_consistency(point[None], orientation, settings)[0]
    three = F.avg_pool1d(runs[None], 3, 1, 1, count_include_pad=True)[0] * 3
    strength = colour_difference(image, point, settings) * three
    return strength.where(runs > 0, 0)


def find_borders(
    image: Tensor, orientation: Tensor, point: Tensor, settings: BorderSettings
) -> Borders:
    """Find the first border, move the vanishing point along it, and find the second border.

    The point moves to where the greatest OCRs of the remaining rays have the largest sum.

    orientation: of the texture, in degrees, shape (H, W). point: row and column of the voted
    vanishing point, shape (2,).
    """
    first = RAY_ANGLES[int(border_strength(image, orientation, point, settings).argmax())]
    distinct = angle_between(RAY_ANGLES, first) > MIN_ANGLE
    turn = first.deg2rad()
    steps = torch.arange(0, image.shape[1], POINT_STEP, device=point.device)[:, None]
    points = point + steps * torch.stack([turn.sin(), turn.cos()]).to(point)
    points = points[
        (points[:, 0] < image.shape[1]) & (points[:, 1] >= 0) & (points[:, 1] < image.shape[2])
    ]
    runs = ray_consistency(points, orientation, settings)[:, distinct]
    moved = points[int(runs.topk(BEST_RAYS).values.sum(1).argmax())]
    strength = border_strength(image, orientation, moved, settings)
    second = RAY_ANGLES[distinct][int(strength[distinct].argmax())]
    return Borders(moved, int(first), int(second))


def road_between(borders: Borders, size: tuple[int, int]) -> Tensor:
    """Return the pixels below the vanishing point and between the borders, bool (H, W)."""
    angle = pixel_angles(borders.point, size)
    low, high = sorted((borders.first, borders.second))
    return (angle >= low) & (angle <= high)
