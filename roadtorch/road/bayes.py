"""Naive Bayes fusion of learned cues and cues of the image, and location priors.

``likelihood_product`` is P2's eq. 4: prior times likelihoods, without a model of the background.
The rest is ours: a cue L in [0, 1] is p(road | cue) at even prior odds, so that cues multiply as
odds, L / (1 - L), and evidence for the background counts as well. Pixels may be ranked differently:
0.9 and 0.3 have the product 0.27 and the odds 3.9, 0.6 and 0.6 the product 0.36 and the odds 2.3.
Over segments one more cue is learned from the others: the appearance of the road in this image.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.imaging.levels import otsu_threshold
from roadtorch.imaging.segments import Bandwidths, Segments, class_log_density, segment_affinity

LIKELIHOOD_EPS = 1e-4
"""Distance from 0 and 1 to which likelihoods are clamped: no single cue can veto the others."""

MAX_APPEARANCE = 3.0
"""Limit of the appearance's log odds, so that neighbours can outvote it: lane markings look unlike
the rest of the road."""


class RoadPosition(NamedTuple):
    """Prior of the road's position: a triangle with soft sides.

    Lengths are fractions of the image's height (rows) and width (columns).
    weight: exponent of the prior; 0 is uniform. apex: row at which the half width is ``narrow``.
    spread: half width gained per height below it. softness: width over which the road fades.
    """

    weight: float = 0.4
    apex: float = 0.69
    narrow: float = 0.07
    spread: float = 1.1
    softness: float = 0.11


class Exponents(NamedTuple):
    """Weights of the cues: exponents of the odds L / (1 - L); ours (see the module).

    layout: ground of the scene layout. distance: from the seed area. texture: uniformity of the
    fused plane. appearance: learned in this image. neighbours: adjacent segments.
    """

    layout: float = 0.44
    distance: float = 1.0
    texture: float = 2.0
    appearance: float = 2.0
    neighbours: float = 6.0


class RoadRules(NamedTuple):
    """Constants by which the cues of an image's segments become p(road).

    half_distance: number of faint borders from the seed area at which the likelihood is 0.5.
    bias: log odds of road before any cue. temperature: divisor of the final ones. rounds: of
    learning the appearance. Halving or doubling a weight moves MaxF by less than .005.
    """

    position: RoadPosition = RoadPosition()
    exponents: Exponents = Exponents()
    half_distance: float = 1.7
    bandwidths: Bandwidths = Bandwidths(0.085, 0.01, 0.07, 0.9, 0.1, 3.0)
    bias: float = -1.8
    temperature: float = 6.0
    rounds: int = 4


ROAD_RULES = RoadRules()


def likelihood_product(prior: Tensor, likelihoods: Sequence[Tensor]) -> Tensor:
    """Compute p(R | cues) up to a constant: p(R) · Π L, P2 eq. 4. All (H, W) in [0, 1].

    "Only considerations about the road are taken into account" (P2, section 5): there is no model
    of the background, so the result is not a probability; it is thresholded as it is.
    A prior counts relative to its largest value: a uniform one changes nothing.
    """
    product = prior / prior.max()
    for likelihood in likelihoods:
        product = product * likelihood
    return product


def log_odds(likelihood: Tensor) -> Tensor:
    """Return log(L / (1 - L)) of likelihoods in [0, 1], kept finite by ``LIKELIHOOD_EPS``."""
    return torch.logit(likelihood, eps=LIKELIHOOD_EPS)


def fused_log_odds(likelihoods: Sequence[Tensor], weights: Sequence[float]) -> Tensor:
    """Return Σ W · log(L / (1 - L)) of likelihoods of one shape, in [0, 1]; 0.5 is neutral.

    Naive Bayes with a model of the background: its sigmoid is Π Lᵂ / (Π Lᵂ + Π (1-L)ᵂ). With
    weights 1 that is not P2's eq. 4, which leaves the background out (``likelihood_product``).
    Summed as log odds, so that no product of small numbers underflows.
    """
    first, *further = zip(likelihoods, weights, strict=True)
    total = log_odds(first[0]).mul_(first[1])
    for likelihood, weight in further:
        total.add_(log_odds(likelihood), alpha=weight)
    return total


def road_position_prior(
    row: Tensor, column: Tensor, position: RoadPosition = ROAD_RULES.position
) -> Tensor:
    """Return the prior p(road) at rows and columns in [0, 1]: a soft triangle ahead (ours)."""
    half = position.narrow + position.spread * (row - position.apex).clamp_min(0)
    return ((half - (column - 0.5).abs()) / position.softness).sigmoid()


def seed_log_odds(segments: Segments, ground: Tensor) -> Tensor:
    """Return the log odds (n,) of road of segments, by position and layout's ground (n,) alone."""
    prior = road_position_prior(segments.row, segments.column)
    return fused_log_odds(
        [ground, prior], [ROAD_RULES.exponents.layout, ROAD_RULES.position.weight]
    )


def segment_road(
    segments: Segments,
    layout: Tensor,
    distance: Tensor,
    texture: Tensor,
    further: Tensor | float = 0.0,
    rules: RoadRules = ROAD_RULES,
) -> Tensor:
    """Compute p(road) of each segment (n,) from its likelihoods (n,) by several cues.

    Naive Bayes over the cues gives a first belief. Then, in rounds, kernel densities of road and
    background are learned from the belief and added as one more cue, as are the neighbours.

    layout: of ground. distance: from the seed area. texture: of uniformity. further: log odds (n,)
    of further cues, added unweighted.
    """
    exponents = rules.exponents
    position = road_position_prior(segments.row, segments.column, rules.position)
    fixed = (
        rules.bias
        + further
        + fused_log_odds(
            [position, layout, distance, texture],
            [rules.position.weight, exponents.layout, exponents.distance, exponents.texture],
        )
    )
    neighbours = exponents.neighbours * neighbour_mean(segments)
    similarity = segment_affinity(segments, rules.bandwidths)
    score = fixed
    for _ in range(rules.rounds):
        belief = score.sigmoid()
        weights = torch.stack([belief, 1 - belief], 1)
        density = class_log_density(similarity, weights, segments.size)
        appearance = (density[:, 0] - density[:, 1]).clamp(-MAX_APPEARANCE, MAX_APPEARANCE)
        score = torch.addmv(fixed, neighbours, 2 * belief - 1)
        score.add_(appearance, alpha=exponents.appearance)
    return (score / rules.temperature).sigmoid()


def neighbour_mean(segments: Segments) -> Tensor:
    """Return the (n, n) matrix that averages a value over each segment's adjacent segments."""
    count = len(segments.size)
    first, second = segments.pairs
    touching = segments.size.new_zeros(count, count)
    touching[first, second] = 1
    touching[second, first] = 1
    return touching / touching.sum(1, keepdim=True).clamp_min(1)


def centred_odds(odds: Tensor, centre: float, weight: float) -> Tensor:
    """Shift the log odds (…) of an image so that road and background separate at 0. Ours.

    Subtracts the mean of ``centre``, the same for all images, and of Otsu's threshold of the image,
    which has the ``weight``. Otsu's follows the best threshold of a camera without labels, but
    alone it is too low for a narrow road.
    """
    if not weight:
        return odds - centre
    return odds - torch.lerp(odds.new_tensor(centre), otsu_threshold(odds), weight)


# --- location priors ------------------------------------------------------------------


TRIANGLE_APEX = 0.45
"""Apex of ``prior_triangle``, as a fraction of the height from the top: a usual horizon."""

TRIANGLE_BASE = 1.16
"""Base of the triangle on the bottom edge, in image widths: the road leaves it at the sides."""


def prior_uniform(height: int, width: int) -> Tensor:
    """Return 0.5 everywhere, float32 (H, W): the uniform prior of P2."""
    return torch.full((height, width), 0.5)


def prior_rows(height: int, width: int) -> Tensor:
    """Return row / height at pixel centres, float32 (H, W): the lower, the more likely road."""
    rows = (torch.arange(height, dtype=torch.float32) + 0.5) / height
    return rows[:, None].expand(height, width).contiguous()


def prior_triangle(height: int, width: int) -> Tensor:
    """Return 1 in a triangle with its base on the bottom edge, 0 elsewhere: float32 (H, W).

    A straight road ahead, ours: apex in the middle at ``TRIANGLE_APEX``, base ``TRIANGLE_BASE``.
    MaxF on the development drives 0001TP, 0006R0 and 0016E5 of CamVid: 0.750, 0.842, 0.863; IDD:
    0.811.
    """
    rows = (torch.arange(height, dtype=torch.float32)[:, None] + 0.5) / height
    columns = (torch.arange(width, dtype=torch.float32) + 0.5) / width
    half_width = TRIANGLE_BASE / 2 * (rows - TRIANGLE_APEX) / (1 - TRIANGLE_APEX)
    return ((columns - 0.5).abs() <= half_width).to(torch.float32)


Prior = Callable[[int, int], Tensor]
"""Function of height and width that returns a prior p(road), float32 (H, W) in [0, 1]."""

PRIORS: dict[str, Prior] = {
    "uniform": prior_uniform,
    "rows": prior_rows,
    "triangle": prior_triangle,
}
