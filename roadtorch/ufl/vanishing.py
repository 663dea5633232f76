"""Road between two borders that meet in a vanishing point (Kong et al. 2010, a baseline of P1).

Kong, Audibert, Ponce, "General road detection from a single image", IEEE TIP 19(8), 2010: Gabor
filters tell which way the texture of each pixel runs, pixels vote for the point at which texture
aims, and from it run the two borders. Angles are in degrees from 0 to 180, from the columns' axis
towards the rows' (clockwise in the image): 0 runs along a row, 90 down a column. Rays point
down, between 0 (right) and 180 (left).
"""

import math
from dataclasses import dataclass

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.settings import Settings

# --- which way texture runs -------------------------------------------------------------

OCTAVES = 2.2
"""c of Kong et al.: waves in the envelope; 2.2 is a spatial bandwidth of 1.7 octaves."""

MARGIN = 24
"""Pixels of mirrored image on each side, so that one edge does not answer to the other."""

FIRST, LAST = 4, 15
"""The responses, by falling size, whose mean is held against the greatest one."""

MIN_RESPONSE = 1e-6
"""The least squared response, of a grey from 0 to 1: below it there is only rounding."""


class GaborBank(Settings):
    """The filters. Kong et al. write of five scales of the frequencies 2.1·2^k.

    We take 2.1/2^k, waves of 3, 6 and 12 pixels: the others would be shorter than a pixel; and of
    24 and 48 pixels, whose responses are so great that they alone would decide.
    """

    orientations: int = Field(default=36, ge=16, le=180, description="evenly spread over 180°")
    scales: int = Field(default=3, ge=1, le=8, description="each of twice the wavelength before")
    frequency: float = Field(
        default=2.1, gt=0, le=math.pi, description="of the finest scale, radians a pixel"
    )


def filter_spectrum(size: tuple[int, int], angle: float, frequency: float) -> Tensor:
    """The Fourier transform (H,W) of the Gabor filter whose waves run at an angle in degrees.

    Kong et al.: w/(sqrt(2 pi) c) exp(-w²(4a² + b²)/(8c²)) (exp(iwa) - exp(-c²/2)), with a
    along the waves and b across; it is real, and 0 where the frequency is 0.
    """
    down = 2 * math.pi * torch.fft.fftfreq(size[0])[:, None]
    right = 2 * math.pi * torch.fft.fftfreq(size[1])
    turn = math.radians(angle)
    along = right * math.cos(turn) + down * math.sin(turn)
    across = down * math.cos(turn) - right * math.sin(turn)
    width = OCTAVES / frequency
    wave = (-((width * (along - frequency)) ** 2) / 2).exp()
    level = (-((width * along) ** 2 + OCTAVES**2) / 2).exp()
    gain = 2 * math.sqrt(2 * math.pi) * width
    return gain * (-((2 * width * across) ** 2) / 2).exp() * (wave - level)


def gabor_responses(grey: Tensor, bank: GaborBank) -> Tensor:
    """Squared magnitudes of the responses, mean over the scales: (orientations,H,W).

    grey: (H,W). The i-th is that of texture that runs at i·180/orientations degrees.
    """
    height, width = grey.shape
    margin = min(MARGIN, height - 1, width - 1)
    padded = F.pad(grey[None, None], (margin,) * 4, mode="reflect")[0, 0]
    spectrum = torch.fft.fft2(padded)
    size = (padded.shape[0], padded.shape[1])
    responses = []
    for step in range(bank.orientations):
        waves = 180 * step / bank.orientations + 90  # they run across the texture
        power = torch.zeros_like(padded)
        for scale in range(bank.scales):
            gabor = filter_spectrum(size, waves, bank.frequency / 2**scale).to(padded)
            power += torch.fft.ifft2(spectrum * gabor).abs().square()
        responses.append(power[margin : margin + height, margin : margin + width] / bank.scales)
    return torch.stack(responses)


def dominant_orientation(responses: Tensor) -> tuple[Tensor, Tensor]:
    """The orientation (H,W) in degrees of the greatest response, and its confidence in [0,1].

    Confidence: 1 - mean(r5 … r15)/r1 of the responses by falling size (Kong et al.),
    scaled so that it spans [0,1] in the image; 0 throughout where there is no texture.
    """
    falling = responses.sort(0, descending=True).values
    top = falling[0].clamp_min(torch.finfo(falling.dtype).tiny)
    sure = (1 - falling[FIRST:LAST].mean(0) / top).where(falling[0] > MIN_RESPONSE, 0)
    low, high = sure.aminmax()
    angle = responses.argmax(0) * (180 / len(responses))
    return angle.to(responses), (sure - low) / torch.where(high > low, high - low, 1)


# --- the vote ---------------------------------------------------------------------------

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


def soft_votes(
    points: Tensor, places: Tensor, angles: Tensor, diagonal: float, settings: VotingSettings
) -> Tensor:
    """The votes (k,) ≥ 0 that points (k,2), rows and columns in pixels, get.

    places: (m,2), of pixels that are sure of their texture; angles: (m,), its own; diagonal: of the
    image, pixels. Kong et al.: a voter below a point and within the radius gives 1/(1 + (g·d)²),
    with g the degrees by which it misses the point and d their distance in diagonals, if g is at
    most 5/(1 + 2d).
    """
    votes = []
    for some in points.split(CHUNK):
        down, right = (places[:, axis] - some[:, axis, None] for axis in (0, 1))
        away = (down.square() + right.square()).sqrt() / diagonal
        missed = angle_between(torch.atan2(down, right).rad2deg(), angles)
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
    ``camera.gradients`` has its heir for footage: it votes with gradients, over many frames.
    """
    height, width = orientation.shape
    sure = confidence > settings.confidence
    places, angles = sure.nonzero().to(orientation), orientation[sure]

    def most_voted(rows: range, columns: range) -> Tensor | None:
        """The point of a grid with the most votes, the first of several; None where all have 0."""
        grid = torch.cartesian_prod(torch.tensor(rows), torch.tensor(columns)).to(places)
        votes = soft_votes(grid, places, angles, (height**2 + width**2) ** 0.5, settings)
        return grid[int(votes.argmax())] if votes.max() > 0 else None

    last, step = max(1, round(settings.lowest * height)), settings.step
    coarse = most_voted(range(0, last, step), range(0, width, step))
    if coarse is None:
        return None
    row, column = (int(place) for place in coarse)
    return most_voted(
        range(max(0, row - step + 1), min(last, row + step)),
        range(max(0, column - step + 1), min(width, column + step)),
    )


# --- the borders ------------------------------------------------------------------------

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
        default=1 / 3, ge=0, le=1, description="of a border in the image at least, in heights"
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
    texture = orientation[row.clamp(0, height - 1), column.clamp(0, width - 1)]
    along = angle_between(texture, CANDIDATES.to(orientation)[:, None]) <= settings.tolerance
    count = inside.sum(-1)
    share = (along & inside).sum(-1) / count.clamp_min(1)
    return share.where(count >= settings.length * height, 0)


def angles_from(point: Tensor, size: tuple[int, int]) -> Tensor:
    """Degrees in (-180,180] at which an image's pixels lie from a point (2,): (H,W)."""
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
    sides = torch.stack([total[:, ray] - total[:, low], total[:, high] - total[:, ray]])
    count = sides[:, :1]
    moments = sides[:, 1:] / count.clamp_min(1)
    mean = moments[:, :3]
    variance = (moments[:, 3:] - mean.square()).clamp_min(0)
    far = (mean[0] - mean[1]).abs() / (variance[0] + variance[1] + 1e-6).sqrt()
    return far.amax(0).where((count > 0).all(0)[0], 0)


def border_strength(
    image: Tensor, orientation: Tensor, point: Tensor, settings: BorderSettings
) -> Tensor:
    """How much each ray from a point (2,) is a border, (29,) ≥ 0.

    Colour difference times the OCR of the ray and its two neighbours together.
    """
    runs = consistency(point[None], orientation, settings)[0]
    three = F.avg_pool1d(runs[None], 3, 1, 1, count_include_pad=True)[0] * 3
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
