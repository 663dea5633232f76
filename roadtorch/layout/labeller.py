"""Machine labels of the scene layout, computed from the image alone (in place of P2's teacher).

P2 takes its noisy labels from Hoiem et al., a classifier trained on another data set. This labeller
needs no training. It starts from a prior on the position of sky, vertical surfaces and ground in
street images, learns the appearance of each class in the image itself, and orders each column as
sky, vertical, horizontal from top to bottom.
"""

from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
import torch
from pydantic import Field
from scipy.linalg import block_diag
from torch import Tensor

from roadtorch.base.image_cache import cached_per_image
from roadtorch.base.settings import Settings
from roadtorch.imaging.color import Exposure, brighten
from roadtorch.imaging.resize import WorkingSize, resize_to_image, resize_to_work, spatial_size
from roadtorch.imaging.segments import (
    Bandwidths,
    Segments,
    class_log_density,
    measure_segments,
    paint_segments,
    segment_affinity,
)
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.classes import HORIZONTAL, NUM_CLASSES, SKY, UNLABELLED, VERTICAL

UNSCALED_ROWS = 32
"""Rows after which products are rescaled, as factors down to 1e-4 would underflow float64."""

MAX_SKY_BLUE = 0.1
"""Strongest blue of a sky: -b of CIELAB over 100."""

HORIZON = 0.5


class PositionPrior(NamedTuple):
    """Prior on the position of the classes: a logistic model of row and column.

    Rows are fractions of the height from the top; sides are fractions of the width from the middle.
    Sky and vertical are equally likely ``sky_rise`` above the horizon, ground and vertical
    ``ground_drop`` below it; both borders slope towards the sides and are blurred by their
    softness, in rows. ``vertical`` is that class's log weight at every position.
    """

    horizon: float = HORIZON
    sky_rise: float = 0.17
    sky_slope: float = 0.65
    sky_softness: float = 0.54
    ground_drop: float = -0.01
    ground_slope: float = 0.32
    ground_softness: float = 0.13
    vertical: float = 0.98


class SkyAppearance(NamedTuple):
    """Appearance of sky in any image: bright, smooth, sometimes blue. Ours.

    ``light``, ``even`` and ``blue`` are the largest log weights that a segment gains or loses for
    being sky. ``lightness`` is the neutral one; the full weight is reached ``softness`` above or
    below it. ``gradient`` is the neutral mean gradient, L per pixel.
    """

    light: float = 0.8
    lightness: float = 0.62
    softness: float = 0.2
    even: float = 1.1
    gradient: float = 0.022
    blue: float = 0.4


class ColumnChain(NamedTuple):
    """Markov chain that orders a column as sky, vertical, horizontal from top to bottom.

    ``weight`` is the exponent of a segment's own evidence; ``change`` the probability, at each step
    down, of moving to the next class; ``breach`` that of any other move; ``step`` the distance of
    samples in pixels at working size.
    """

    weight: float = 2.1
    change: float = 0.03
    breach: float = 1e-3
    step: int = 8


class LabellerRules(NamedTuple):
    """Constants of the labeller; ``sharpness`` weights appearance against position."""

    position: PositionPrior = PositionPrior()
    sky: SkyAppearance = SkyAppearance()
    bandwidths: Bandwidths = Bandwidths(0.135, 0.045, 0.07, 0.09, 1.3, 0.8)
    order: ColumnChain = ColumnChain()
    sharpness: float = 1.17
    rounds: int = 5
    exposure: Exposure = Exposure()


LABELLER_RULES = LabellerRules()

UNTUNED_RULES = LabellerRules(
    # Walls 6 m aside and 6 m above a level 4:3 camera, itself 1.5 m above the ground: per width, a
    # wall's foot falls by (4/3) · 1.5/6 and its top rises by (4/3) · 6/6 of the height.
    PositionPrior(
        horizon=1 / 2,
        sky_rise=1 / 3,
        sky_slope=4 / 3,
        sky_softness=1 / 10,  # the lines are known to a tenth of the height
        ground_drop=1 / 12,
        ground_slope=1 / 3,
        ground_softness=1 / 10,
        vertical=0.0,  # no class is likelier than another
    ),
    SkyAppearance(light=0.0, even=0.0, blue=0.0),  # no appearance of the sky
    # A tenth of the range of each property; a class looks alike all over the image.
    Bandwidths(0.1, 0.1, 0.1, 0.1, 1.0, 1.0),
    # Two changes of class in a column of 240 / 8 steps; a wrong order is one in a thousand.
    ColumnChain(weight=1.0, change=2 / 30, breach=1e-3),
    sharpness=1.0,  # appearance weighs as much as position
    exposure=Exposure(ground=1 / 2),  # mid grey
)
"""Constants from geometry and round numbers, fixed before any score was computed: a teacher that is
tuned on no label, to test P2's claim with. Those of ``LABELLER_RULES`` were chosen on labels."""

MIN_MARGIN = 0.5
"""Least difference of the two best potentials for a pixel to be labelled."""


class HorizonSettings(Settings):
    """Settings of the layout labeller that depend on the camera."""

    horizon: float = Field(
        default=HORIZON, ge=0, le=1, description="row of the horizon, fraction of the height"
    )
    constants: Literal["tuned", "untuned"] = Field(
        default="tuned",
        description="constants chosen on labelled images, or from geometry and round numbers",
    )

    @property
    def rules(self) -> LabellerRules:
        """Constants of the labeller with this horizon."""
        rules = LABELLER_RULES if self.constants == "tuned" else UNTUNED_RULES
        return rules._replace(position=rules.position._replace(horizon=self.horizon))


class LabellerSettings(HorizonSettings):
    """Settings of the layout labeller where its labels are the result."""

    margin: float = Field(
        default=MIN_MARGIN,
        ge=0,
        le=1,
        description="least difference of the two best potentials for a label",
    )
    support: Literal["margin", "maximum"] = Field(
        default="margin",
        description="margin: leave ambiguous segments unlabelled; maximum: label all (paper)",
    )

    @property
    def min_margin(self) -> float:
        """Least difference of the two best potentials; 0 where every pixel is labelled."""
        return self.margin if self.support == "margin" else 0.0


class LayoutLabels(NamedTuple):
    """Potentials (3, H, W) that sum to 1, and labels int64 (H, W): 0, 1, 2, or 255."""

    potentials: Tensor
    labels: Tensor


def label_layout(
    image: Tensor,
    settings: LabellerSettings | None = None,
    working: WorkingSize | None = None,
    superpixels: Superpixels | None = None,
) -> LayoutLabels:
    """Label an image (3, H, W) in [0, 1]: 0 sky, 1 vertical, 2 horizontal, 255 unlabelled.

    It is processed at the ``working`` size, and the result has the size of the image.
    """
    settings, superpixels = settings or LabellerSettings(), superpixels or Superpixels()
    small = resize_to_work(image, working or WorkingSize())
    labelled = label_at_image_size(small, settings, superpixels, settings.min_margin)
    return LayoutLabels(*(resize_to_image(cue, spatial_size(image)) for cue in labelled))


def label_at_image_size(
    image: Tensor, settings: HorizonSettings, superpixels: Superpixels, margin: float = MIN_MARGIN
) -> LayoutLabels:
    """Label an image as ``label_layout`` does, at the image's own size."""
    _, segments, potentials = label_segments(image, settings, superpixels)
    layout = potentials.T, decide_layout(potentials, margin)
    return LayoutLabels(*(paint_segments(values, segments.labels) for values in layout))


def label_segments(
    image: Tensor, settings: HorizonSettings, superpixels: Superpixels
) -> tuple[Tensor, Segments, Tensor]:
    """Return the brightened image (3, H, W), its n segments and their potentials (n, 3)."""
    bright = brighten(image, settings.rules.exposure)
    segments = measure_segments(bright, superpixels.cut(bright))
    return bright, segments, segment_layout(segments, settings.rules)


@cached_per_image
def segment_layout(segments: Segments, rules: LabellerRules = LABELLER_RULES) -> Tensor:
    """Return potentials (n, 3) of sky, vertical, horizontal for n segments; rows sum to 1.

    Each round learns the appearance of the classes from the current beliefs (kernel density),
    scores each segment by position and appearance, and orders the columns: expectation maximisation
    with a fixed prior. Ours.
    """
    prior = position_prior(segments.row, segments.column, rules.position).log()
    prior[:, SKY] += sky_evidence(segments, rules.sky)
    prior = prior.log_softmax(1)
    samples = column_samples(segments.labels, rules.order.step)
    affinity = segment_affinity(segments, rules.bandwidths)
    belief = prior.exp()
    for _ in range(rules.rounds):
        evidence = class_log_density(affinity, belief, segments.size)
        belief = smooth_columns(prior.add(evidence, alpha=rules.sharpness), samples, rules.order)
    return belief


def position_prior(row: Tensor, column: Tensor, prior: PositionPrior) -> Tensor:
    """Return p(class) (n, 3) at rows and columns (n,) in [0, 1]: softmax of linear scores.

    Models a street seen from a car: sky above the horizon and higher at the sides, where buildings
    are; ground below it and lower at the sides. Ours.
    """
    side = (column - 0.5).abs() - 0.25
    sky = (prior.horizon - prior.sky_rise - prior.sky_slope * side - row) / prior.sky_softness
    ground = row - prior.horizon - prior.ground_drop - prior.ground_slope * side
    vertical = torch.full_like(row, prior.vertical)
    return torch.stack([sky, vertical, ground / prior.ground_softness], 1).softmax(1)


def sky_evidence(segments: Segments, sky: SkyAppearance) -> Tensor:
    """Return log weights (n,) of sky: positive for bright, smooth or blue segments. Ours."""
    light = ((segments.color[0] - sky.lightness) / sky.softness).clamp(-1, 1)
    even = (1 - segments.gradient / sky.gradient).clamp(-1, 1)
    blue = (-segments.color[2] / MAX_SKY_BLUE).clamp(-1, 1)
    return sky.light * light + sky.even * even + sky.blue * blue


def column_samples(labels: Tensor, step: int) -> np.ndarray:
    """Return every ``step``-th pixel of labels (H, W), at least one: shape (R, C)."""
    first = min(step, *labels.shape) // 2  # inside, however large the step
    return labels[first::step, first::step].cpu().numpy()


def smooth_columns(scores: Tensor, samples: np.ndarray, order: ColumnChain) -> Tensor:
    """Return beliefs (n, 3) from log scores (n, 3), each column ordered by a Markov chain. Ours.

    A column of ``samples``, the segment numbers (R, C) from ``column_samples``, is a hidden Markov
    chain. Its posteriors (forward-backward algorithm) are averaged over each segment.
    """
    local = (order.weight * scores.to(torch.float64)).softmax(1).clamp_min_(1e-4).cpu().numpy()
    posterior = _chain_posterior(local.take(samples, 0), _transitions(order.change, order.breach))
    index = (NUM_CLASSES * samples.reshape(-1, 1) + np.arange(NUM_CLASSES)).reshape(-1)
    belief = np.bincount(index, posterior.reshape(-1), minlength=local.size).reshape(local.shape)
    unsampled = ~belief.any(1)  # these segments keep their own evidence
    belief[unsampled] = local[unsampled]
    belief /= belief @ np.ones((NUM_CLASSES, 1))
    return torch.from_numpy(belief).to(scores)


@lru_cache(maxsize=8)
def _transitions(change: float, breach: float) -> np.ndarray:
    """Return transition probabilities (6, 6): a block (3, 3) down, a block (3, 3) up."""
    move = np.full((NUM_CLASSES, NUM_CLASSES), breach)
    move[SKY, VERTICAL] = move[VERTICAL, HORIZONTAL] = change
    np.fill_diagonal(move, 0)
    np.fill_diagonal(move, 1 - move.sum(1))
    return np.asarray(block_diag(move, move.T))


def _chain_posterior(evidence: np.ndarray, transitions: np.ndarray) -> np.ndarray:
    """Return posteriors (R, C, 3) of chains down the columns of evidence (R, C, 3), > 0.

    Forward and backward pass run side by side, in NumPy: three times as fast as torch here.
    """
    states = np.concatenate([evidence, evidence[::-1]], 2)
    for row in range(1, len(states)):
        previous = states[row - 1]
        if row % UNSCALED_ROWS == 0:  # rescale each of the two chains to sum 1
            chains = previous.reshape(-1, 2, NUM_CLASSES)
            previous = (chains / chains.sum(2, keepdims=True)).reshape(previous.shape)
        states[row] *= previous @ transitions
    down, up = states[..., :NUM_CLASSES], states[::-1, :, NUM_CLASSES:]
    posterior = down * up / evidence
    return posterior / (posterior @ np.ones((NUM_CLASSES, 1)))  # a sum over three, faster


def decide_layout(potentials: Tensor, margin: float = MIN_MARGIN) -> Tensor:
    """Return labels (…) of the largest potentials (…, 3); 255 below the margin."""
    # Plane by plane, the largest label that holds: argmax and ``where`` take several times as long.
    sky, vertical, horizontal = potentials.unbind(-1)
    higher, lower = torch.maximum(sky, vertical), torch.minimum(sky, vertical)
    lead = torch.maximum(higher, horizontal)
    lead = lead - torch.maximum(lower, torch.minimum(higher, horizontal))
    is_vertical, is_horizontal = (vertical > sky).byte(), (horizontal > higher).byte()
    labels = torch.maximum(is_vertical * VERTICAL, is_horizontal * HORIZONTAL)
    return torch.maximum(labels, (lead < margin).byte() * UNLABELLED).long()
