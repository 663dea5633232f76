"""Machine labels of the scene layout, from the image alone (stands in for P2's teacher).

P2 takes its noisy labels from Hoiem et al., a classifier trained on another data set. This
labeller needs no training. It starts from where sky, vertical things and ground tend to be
in a street image, learns from the image itself what each of them looks like, and lets
each column of the image read sky, vertical, horizontal from top to bottom.
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
from roadtorch.imaging.color import Exposure, brightened
from roadtorch.imaging.resize import WorkingSize, at_image_size, at_work, size_of
from roadtorch.imaging.segments import (
    Bandwidths,
    Segments,
    class_log_density,
    likeness,
    measure_segments,
    paint,
)
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.classes import CLASSES, HORIZONTAL, SKY, UNLABELLED, VERTICAL

UNSCALED = 32
"""Rows of a chain, of at least 1e-4 each, whose product a float64 still holds; two of them."""

BLUEST = 0.1
"""The b of Lab, over 100, that is as blue as a sky gets."""


class PlacePrior(NamedTuple):
    """Where the classes tend to be: a logistic model of row and column (see ``place_prior``).

    Rows are shares of the height from the top; sides are shares of the width from the middle.
    Sky is even with vertical ``sky_rise`` above the horizon, ground ``ground_drop`` below it; both
    lines move by their slopes towards the sides, and fade over their softness in rows. vertical:
    its log weight everywhere.
    """

    horizon: float = 0.5
    sky_rise: float = 0.17
    sky_slope: float = 0.65
    sky_softness: float = 0.54
    ground_drop: float = -0.01
    ground_slope: float = 0.32
    ground_softness: float = 0.13
    vertical: float = 0.98


class SkyLook(NamedTuple):
    """What sky looks like anywhere: light comes from it, it is even, and at times blue. Ours.

    light, even, blue: the log weights that a segment gains or loses at most for being sky. level:
    the lightness that says nothing; from there to the whole weight it takes ``softness``.
    gradient: the mean gradient, L per pixel, that says nothing.
    """

    light: float = 0.8
    level: float = 0.62
    softness: float = 0.2
    even: float = 1.1
    gradient: float = 0.022
    blue: float = 0.4


class ColumnOrder(NamedTuple):
    """How strictly a column reads sky, vertical, horizontal from top to bottom.

    weight: of a segment's own evidence. change: chance of the next class, a step down. breach:
    chance of any other change, a step. step: its pixels, at working size.
    """

    weight: float = 2.1
    change: float = 0.03
    breach: float = 1e-3
    step: int = 8


class LabellerRules(NamedTuple):
    """How the labeller reads an image. sharpness: weight of appearance against place."""

    place: PlacePrior = PlacePrior()
    sky: SkyLook = SkyLook()
    bandwidths: Bandwidths = Bandwidths(0.135, 0.045, 0.07, 0.09, 1.3, 0.8)
    order: ColumnOrder = ColumnOrder()
    sharpness: float = 1.17
    rounds: int = 5


RULES = LabellerRules()

EXPOSURE = Exposure()

MARGIN = 0.5
"""By how much the best potential must lead to give a label."""


class HorizonSettings(Settings):
    """What a detector can tell the layout labeller: what differs from camera to camera."""

    horizon: float = Field(
        default=RULES.place.horizon, ge=0, le=1, description="its row, a share of the height"
    )

    @property
    def rules(self) -> LabellerRules:
        """All that the labeller goes by."""
        return RULES._replace(place=RULES.place._replace(horizon=self.horizon))


class LabellerSettings(HorizonSettings):
    """Settings of the layout labeller where its labels are what counts."""

    margin: float = Field(
        default=MARGIN,
        ge=0,
        le=1,
        description="by how much the best potential must lead to give a label",
    )
    support: Literal["margin", "maximum"] = Field(
        default="margin",
        description="leave doubtful segments unlabelled, or label all as the paper does",
    )

    @property
    def lead(self) -> float:
        """By how much the best potential must lead: by nothing where all is labelled."""
        return self.margin if self.support == "margin" else 0.0


class LayoutLabels(NamedTuple):
    """potentials (3,H,W) in [0,1], summing to 1; labels int64 (H,W): 0, 1, 2, or 255."""

    potentials: Tensor
    labels: Tensor


def label_layout(
    image: Tensor,
    settings: LabellerSettings | None = None,
    working: WorkingSize | None = None,
    superpixels: Superpixels | None = None,
) -> LayoutLabels:
    """Label an image (3,H,W) in [0,1] as sky, vertical, horizontal (0, 1, 2; 255 in doubt).

    It is looked at in its working size. Where settings are left out, their defaults hold. The
    maps have the image's size.
    """
    settings, superpixels = settings or LabellerSettings(), superpixels or Superpixels()
    small = at_work(image, working or WorkingSize())
    found = label_whole(small, settings, superpixels, settings.lead)
    return LayoutLabels(*(at_image_size(map, size_of(image)) for map in found))


def label_whole(
    image: Tensor, settings: HorizonSettings, superpixels: Superpixels, margin: float = MARGIN
) -> LayoutLabels:
    """The same with the image looked at as it is."""
    bright = brightened(image, EXPOSURE)
    segments = measure_segments(bright, superpixels.cut(bright))
    potentials = segment_layout(segments, settings.rules)
    labels = decide_layout(potentials, margin)
    return LayoutLabels(paint(potentials.T, segments.labels), paint(labels, segments.labels))


@cached_per_image
def segment_layout(segments: Segments, rules: LabellerRules = RULES) -> Tensor:
    """Potentials (n,3) of n segments: sky, vertical, horizontal; each row sums to 1.

    Rounds of: learn each class's look from the current beliefs (kernel density), judge every
    segment by place and look, put the columns in order. Ours; the rounds are those of
    expectation maximisation with a prior that does not move.
    """
    prior = place_prior(segments.row, segments.column, rules.place).log()
    prior[:, SKY] += sky_look(segments, rules.sky)
    prior = prior.log_softmax(1)
    samples = column_samples(segments.labels, rules.order.step)
    alike = likeness(segments, rules.bandwidths)
    belief = prior.exp()
    for _ in range(rules.rounds):
        evidence = class_log_density(alike, belief, segments.size)
        belief = in_order(prior.add(evidence, alpha=rules.sharpness), samples, rules.order)
    return belief


def place_prior(row: Tensor, column: Tensor, place: PlacePrior) -> Tensor:
    """p(class) at rows and columns (n,) from 0 to 1: (n,3), softmax of three linear scores.

    A street seen from a car: sky above the horizon and higher at the sides, where the
    buildings are; ground below it and lower at the sides. Ours.
    """
    side = (column - 0.5).abs() - 0.25
    sky = (place.horizon - place.sky_rise - place.sky_slope * side - row) / place.sky_softness
    ground = row - place.horizon - place.ground_drop - place.ground_slope * side
    vertical = torch.full_like(row, place.vertical)
    return torch.stack([sky, vertical, ground / place.ground_softness], 1).softmax(1)


def sky_look(segments: Segments, sky: SkyLook) -> Tensor:
    """How far each of n segments looks like sky, (n,): log weights, 0 says nothing. Ours.

    Without it, clouds and the pale sky above the horizon are as much like a wall as like the
    blue above them.
    """
    light = ((segments.color[0] - sky.level) / sky.softness).clamp(-1, 1)
    even = (1 - segments.gradient / sky.gradient).clamp(-1, 1)
    blue = (-segments.color[2] / BLUEST).clamp(-1, 1)
    return sky.light * light + sky.even * even + sky.blue * blue


def column_samples(labels: Tensor, step: int) -> np.ndarray:
    """Every ``step``-th pixel of labels (H,W), at least one: (R,C)."""
    middle = min(step, *labels.shape) // 2  # inside, whatever the step
    return labels[middle::step, middle::step].cpu().numpy()


def in_order(scores: Tensor, samples: np.ndarray, order: ColumnOrder) -> Tensor:
    """Beliefs (n,3) from log scores (n,3) when every column should read sky, vertical, ground.

    samples: segments (R,C) of an image, by ``column_samples``; each column is a hidden
    Markov chain that moves from sky to vertical to horizontal. The exact posteriors
    (forwards and backwards) are averaged over each segment. Ours.
    """
    local = (order.weight * scores.to(torch.float64)).softmax(1).clamp_min_(1e-4).cpu().numpy()
    posterior = _chain_posterior(local.take(samples, 0), _moves(order.change, order.breach))
    place = (CLASSES * samples.reshape(-1, 1) + np.arange(CLASSES)).reshape(-1)
    belief = np.bincount(place, posterior.reshape(-1), minlength=local.size).reshape(local.shape)
    unseen = ~belief.any(1)  # segments without a sample keep their own say
    belief[unseen] = local[unseen]
    belief /= belief @ np.ones((CLASSES, 1))
    return torch.from_numpy(belief).to(scores)


@lru_cache(maxsize=8)
def _moves(change: float, breach: float) -> np.ndarray:
    """Chances (6,6) of a step: read from the top (3,3), and beside them from the bottom."""
    move = np.full((CLASSES, CLASSES), breach)
    move[SKY, VERTICAL] = move[VERTICAL, HORIZONTAL] = change
    np.fill_diagonal(move, 0)
    np.fill_diagonal(move, 1 - move.sum(1))
    return np.asarray(block_diag(move, move.T))


def _chain_posterior(evidence: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Posterior (R,C,3) of the chains that run down the columns of evidence (R,C,3), > 0.

    Read from the top with the chances of change, and from the bottom with their transpose, both
    at once: they stand side by side. Float64 holds ``UNSCALED`` rows of products. In NumPy: for
    matrices as small as these torch takes three times as long.
    """
    states = np.concatenate([evidence, evidence[::-1]], 2)
    for row in range(1, len(states)):
        before = states[row - 1]
        if row % UNSCALED == 0:  # the sums of each of the two chains are brought to 1
            chains = before.reshape(-1, 2, CLASSES)
            before = (chains / chains.sum(2, keepdims=True)).reshape(before.shape)
        states[row] *= before @ moves
    down, up = states[..., :CLASSES], states[::-1, :, CLASSES:]
    posterior = down * up / evidence
    return posterior / (posterior @ np.ones((CLASSES, 1)))  # its sum over three, sooner


def decide_layout(potentials: Tensor, margin: float = MARGIN) -> Tensor:
    """Labels (…) of the largest potentials (…,3); 255 where the margin to the second is less."""
    # Of three potentials, compared plane by plane: argmax of triples takes ten times as long.
    sky, vertical, horizontal = potentials.unbind(-1)
    higher, lower = torch.maximum(sky, vertical), torch.minimum(sky, vertical)
    best = torch.maximum(higher, horizontal)
    labels = torch.where(sky == best, SKY, torch.where(vertical == best, VERTICAL, HORIZONTAL))
    second = torch.maximum(lower, torch.minimum(higher, horizontal))
    return torch.where(best - second >= margin, labels, UNLABELLED)
