"""Gradients of small grey frames: static pixels, vanishing point and horizon. Ours.

At the edge of a bonnet, a dashboard or a wiper, the gradient has the same direction in every
frame; on the street it varies. Lane marks, kerbs, rails and the feet of houses run ahead and meet
in a point on the horizon: each frame's strong gradients vote for the points that their edges aim
at (after Kong, Audibert and Ponce, "Vanishing point detection for road detection", CVPR 2009, who
vote with Gabor filters in one image). Frames are reduced to a width of 320 pixels: edges of the
ego car stay visible, and a hundred frames take seconds.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.imaging.color import LUMA
from roadtorch.layout.classes import HORIZONTAL

SMALL_WIDTH = 320  # pixels in a row of a small frame
GRADIENT_OFFSET = 8.0  # grey levels of 255: gradients far below it are noise and count little
BLUR_SIGMA = 0.8  # pixels; standard deviation of the Gaussian that removes a small frame's noise

# Mean length at which coherence is halved: a road's shading is constant in all frames, but faint.
FAINT_LENGTH = 0.12


class GradientStatistics(NamedTuple):
    """Statistics over n frames of normalised gradients u = g / (|g| + 8 grey levels).

    Attributes:
        mean: mean of u, right and down, shape (2, h, w).
        mean_square: mean of u², by component, shape (2, h, w).
        mean_length: mean of |u|, shape (h, w).
        frames: n.
    """

    mean: Tensor
    mean_square: Tensor
    mean_length: Tensor
    frames: int

    @property
    def agreement(self) -> Tensor:
        """Root of the mean of u·u' over pairs of different frames, in [0, 1], shape (h, w).

        Unrelated frames give 0 on average, for any number of them; negative means become 0.
        """
        n = self.frames
        pairs = (self.mean.square() * n - self.mean_square).sum(0) / (n - 1)
        return pairs.clamp_min(0).sqrt()

    @property
    def coherence(self) -> Tensor:
        """``agreement`` over the mean length, in [0, 1], shape (h, w); small where all is faint."""
        return (self.agreement / (self.mean_length + FAINT_LENGTH)).clamp(0, 1)

    @property
    def static_fraction(self) -> float:
        """Fraction of all gradients that are static, in [0, 1]: about 1 where nothing moves."""
        return float(self.agreement.sum() / self.mean_length.sum().clamp_min(1e-9))

    @property
    def direction(self) -> Tensor:
        """Unit vectors of the mean gradient, shape (2, h, w); 0 where there is none."""
        return self.mean / self.mean.square().sum(0).sqrt().clamp_min(1e-9)


def small_grey(image: Tensor, size: tuple[int, int]) -> Tensor:
    """Return an image (3, H, W) in [0, 1] as grey levels (h, w), 0 to 255: ITU-R BT.601 luma."""
    luma = torch.einsum("chw,c->hw", image, image.new_tensor(LUMA)) * 255
    pixels = np.ascontiguousarray(luma.float().cpu().numpy())
    return torch.from_numpy(cv2.resize(pixels, size[::-1], interpolation=cv2.INTER_AREA))


def small_size(frames: Sequence[Tensor]) -> tuple[int, int]:
    """Return the reduced (height, width) of frames (..., H, W): that of their median shape."""
    shapes = sorted(frame.shape[-2] / frame.shape[-1] for frame in frames)
    return max(16, round(shapes[len(shapes) // 2] * SMALL_WIDTH)), SMALL_WIDTH


def sobel_gradient(grey: Tensor) -> Tensor:
    """Return Sobel's gradient (2, h, w), right and down, of grey levels (h, w), per two pixels."""
    smooth = cv2.GaussianBlur(grey.numpy(), (0, 0), BLUR_SIGMA)
    parts = [cv2.Sobel(smooth, cv2.CV_32F, *order, scale=1 / 4) for order in ((1, 0), (0, 1))]
    return torch.from_numpy(np.stack(parts))


def soft_normalize(gradient: Tensor) -> Tensor:
    """Normalise a gradient (2, h, w) to lengths below 1: g / (|g| + 8 grey levels)."""
    return gradient / (gradient.square().sum(0).sqrt() + GRADIENT_OFFSET)


def gradient_statistics(gradients: Sequence[Tensor]) -> GradientStatistics:
    """Return the statistics of the gradients (2, h, w) of two or more frames."""
    total, squares = torch.zeros_like(gradients[0]), torch.zeros_like(gradients[0])
    lengths = torch.zeros_like(gradients[0][0])
    for unit in map(soft_normalize, gradients):
        total += unit
        squares += unit.square()
        lengths += unit.square().sum(0).sqrt()
    n = len(gradients)
    return GradientStatistics(total / n, squares / n, lengths / n, n)


# --- vanishing point ------------------------------------------------------------------

FAINT_EDGE = 4.0  # grey levels over two pixels below which an edge has no reliable direction
CANDIDATE_ROWS = tuple(0.2 + 0.025 * step for step in range(22))  # fractions of the height
CANDIDATE_COLUMNS = tuple(0.2 + 0.025 * step for step in range(25))  # fractions of the width
MAX_VOTERS = 1500  # strongest edges of a frame that vote
VOTE_WIDTH = 0.05  # sine of the angle between edge and candidate at which a vote counts 1/e
PSEUDO_VOTES = 15  # pseudo-count per frame and candidate, so that few votes weigh little

# Gaussian prior of the vanishing point: its mean row and column, and their standard deviation.
PRIOR_MEAN, PRIOR_DEVIATION = (0.47, 0.5), 0.12


class VanishingPoint(NamedTuple):
    """Position of a vanishing point, as fractions of the height and of the width."""

    row: float
    column: float


def vanishing_point(gradients: Sequence[Tensor]) -> VanishingPoint:
    """Estimate the point at which the edges of the frames' gradients (2, h, w) aim.

    The maximum of a Gaussian prior times the fractions of edges that aim at the point, left of it
    and right of it: a long line aims at all points along it, but lines of the other side cross it
    in one.
    """
    axes = torch.tensor(CANDIDATE_ROWS), torch.tensor(CANDIDATE_COLUMNS)
    rows, columns = torch.meshgrid(*axes, indexing="ij")
    votes = voters = torch.zeros(2, rows.numel())
    for gradient in gradients:
        new_votes, new_voters = _cast_votes(gradient, rows.reshape(-1), columns.reshape(-1))
        votes, voters = votes + new_votes, voters + new_voters
    score = (votes / (voters + PSEUDO_VOTES * len(gradients))).prod(0).reshape(rows.shape)
    distance = (rows - PRIOR_MEAN[0]).square() + (columns - PRIOR_MEAN[1]).square()
    best = int((score * (-distance / (2 * PRIOR_DEVIATION**2)).exp()).argmax())
    return VanishingPoint(
        CANDIDATE_ROWS[best // len(CANDIDATE_COLUMNS)],
        CANDIDATE_COLUMNS[best % len(CANDIDATE_COLUMNS)],
    )


def line_deviation(direction: Tensor, point: VanishingPoint) -> Tensor:
    """Return how far edges deviate from the vanishing point: (h, w) in [0, 1], 0 on road lines.

    direction: unit gradients (2, h, w). The sine of the angle between edge and line of sight,
    scaled from .15 (9°, within the error of the point) to .35 (20°).
    """
    height, width = direction.shape[1:]
    down = torch.arange(height).view(-1, 1) - point.row * height
    right = torch.arange(width).view(1, -1) - point.column * width
    distance = (right.square() + down.square()).sqrt().clamp_min(1e-6)
    sine = (direction[0] * right + direction[1] * down).abs() / distance
    return ((sine - 0.15) / 0.2).clamp(0, 1)


def road_lines(gradients: Sequence[Tensor], point: VanishingPoint) -> Tensor:
    """Sum the strength of slanting edges that aim at the vanishing point, and of all: (2, h, w).

    Any ground sees lanes, kerbs and rails pass sooner or later; reflections on a bonnet have all
    directions.
    """
    total = torch.zeros(2, 1, 1)
    for gradient in gradients:
        strength = gradient.square().sum(0).sqrt()
        direction = gradient / strength.clamp_min(1e-9)
        slanting = (strength > FAINT_EDGE) & (direction[0].abs() > 0.2)
        weight = soft_normalize(gradient).square().sum(0).sqrt() * slanting
        aims = line_deviation(direction, point) < 0.25
        total = total + torch.stack([weight * aims, weight])
    return total


def _cast_votes(gradient: Tensor, rows: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
    """Return the votes (2, k) for k candidates from edges left and right of each, and the voters.

    Strong slanting edges below the sky vote.
    """
    height, width = gradient.shape[1:]
    strength = gradient.square().sum(0).sqrt()
    slanting = (gradient[0].abs() > 0.2 * strength) & (gradient[1].abs() > 0.25 * strength)
    slanting[: round(0.3 * height)] = False
    edges = torch.where(slanting & (strength > 8), strength, 0).reshape(-1)
    strongest = edges.sort(descending=True, stable=True).indices[:MAX_VOTERS]
    strongest = strongest[edges[strongest] > 0]
    y, x = strongest // width, strongest % width
    normal = gradient[:, y, x] / strength[y, x]
    right = x - columns[:, None] * width
    down = y - rows[:, None] * height
    distance = (right.square() + down.square()).sqrt().clamp_min(1e-6)
    sine = (right * normal[0] + down * normal[1]) / distance
    vote = (-(sine / VOTE_WIDTH).square()).exp()
    is_voter = (down > 0.04 * height) & (distance > 0.1 * width)
    sides = torch.stack([is_voter & (right < 0), is_voter & (right > 0)]).to(vote)
    return (vote * sides).sum(2), sides.sum(2)


# --- horizon of one image -------------------------------------------------------------

# Fractions of the height, but for the columns.
GROUND_QUANTILE = 0.05  # fraction of columns that may be mislabelled above the farthest ground
GROUND_BELOW_HORIZON = 0.025  # the median of 16 rendered streets and four images of KITTI
MIN_GROUND_FRACTION = 0.25  # fraction of columns that have to end in ground
MAX_DISAGREEMENT = 0.15  # between ground and vanishing point
MIN_HORIZON_DEVIATION = 0.025  # root-mean-square error where they agree

PITCH_HINT = "give --set grid.pitch, or --camera with a file of roadtorch camera"


class Horizon(NamedTuple):
    """Row of the horizon and its standard deviation, as fractions of the height."""

    row: float
    deviation: float


def estimate_horizon(image: Tensor, layout: Tensor) -> Horizon:
    """Estimate the horizon of an image from its layout and its vanishing point.

    Args:
        image: sRGB in [0, 1], shape (3, H, W).
        layout: potentials of sky, vertical and horizontal, shape (3, H, W).

    Raises:
        InputError: for hardly any ground, ground up to the upper edge, and lines that meet far
            from the end of the ground.
    """
    if not torch.isfinite(layout).all():
        raise InputError("image", "has a layout that is not finite", PITCH_HINT)
    height = layout.shape[-2]
    ground = layout.argmax(0) == HORIZONTAL
    run = ground.flip(0).int().cummin(0).values.sum(0)  # from the lower edge upwards
    if float((run > 0).double().mean()) < MIN_GROUND_FRACTION:
        raise InputError("image", "shows too little ground to estimate the horizon", PITCH_HINT)
    top = float((height - run[run > 0].double()).quantile(GROUND_QUANTILE)) / height
    if top <= 0:
        raise InputError("image", "shows ground up to its upper edge, no horizon", PITCH_HINT)
    grey = small_grey(image, small_size([image]))
    meeting = vanishing_point([sobel_gradient(grey)]).row
    by_ground, by_lines = max(top - GROUND_BELOW_HORIZON, 0.0), min(meeting, top)
    if abs(by_ground - meeting) > MAX_DISAGREEMENT:
        problem = f"has ground up to row {top:.2f}, but lines that meet at row {meeting:.2f}"
        raise InputError("image", problem, PITCH_HINT)
    deviation = max(MIN_HORIZON_DEVIATION, abs(by_ground - meeting) / 2)
    return Horizon((by_ground + by_lines) / 2, deviation)
