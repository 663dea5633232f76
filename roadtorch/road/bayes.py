"""P2's product, naive Bayes over an image's cues, and location priors.

``likelihood_product`` is P2's eq. 4: prior times likelihoods, without a model of the background.
The rest is ours: a cue L in [0, 1] is p(road | cue) at even prior odds, so that cues multiply as
odds, L / (1 - L), and evidence for the background counts as well. Pixels may be ranked differently:
0.9 and 0.3 have the product 0.27 and the odds 3.9, 0.6 and 0.6 the product 0.36 and the odds 2.3.
Over segments one more cue is learned from the others: the appearance of the road in this image.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from roadtorch.imaging.segments import Bandwidths, Segments, class_log_density, segment_affinity

LIKELIHOOD_EPS = 1e-4
"""Distance from 0 and 1 to which likelihoods are clamped: no single cue can veto the others."""

MAX_APPEARANCE = 3.0
"""Limit of the appearance's log odds, so that neighbours can outvote it: lane markings look unlike
the rest of the road."""


# The road's position: a triangle with soft sides, in fractions of the image's height and width.
APEX, NARROW = 0.69, 0.07  # row at which the half width is ``NARROW``
SPREAD, SOFTNESS = 1.1, 0.11  # half width gained per height below it; width over which road fades

# Exponents of the odds L / (1 - L); ours. Halving or doubling one moves MaxF by less than .005.
POSITION_WEIGHT, LAYOUT_WEIGHT = 0.4, 0.44  # of the road's position, and of the layout's ground
DISTANCE_WEIGHT, TEXTURE_WEIGHT = 1.0, 2.0  # from the seed area; uniformity of the fused plane
APPEARANCE_WEIGHT, NEIGHBOUR_WEIGHT = 2.0, 6.0  # learned in this image; adjacent segments

BANDWIDTHS = Bandwidths(0.085, 0.01, 0.07, 0.9, 0.1, 3.0)
BIAS, TEMPERATURE = -1.8, 6.0  # log odds of road before any cue; divisor of the final ones
LEARNING_ROUNDS = 4  # of learning the appearance


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


def road_position_prior(row: Tensor, column: Tensor) -> Tensor:
    """Return the prior p(road) at rows and columns in [0, 1]: a soft triangle ahead (ours)."""
    half = NARROW + SPREAD * (row - APEX).clamp_min(0)
    return ((half - (column - 0.5).abs()) / SOFTNESS).sigmoid()


def segment_road(segments: Segments, layout: Tensor, distance: Tensor, texture: Tensor) -> Tensor:
    """Compute p(road) of each segment (n,) from its likelihoods (n,) by several cues.

    Naive Bayes over the cues gives a first belief. Then, in rounds, kernel densities of road and
    background are learned from the belief and added as one more cue, as are the neighbours.

    layout: of ground. distance: from the seed area. texture: of uniformity.
    """
    position = road_position_prior(segments.row, segments.column)
    exponents = [POSITION_WEIGHT, LAYOUT_WEIGHT, DISTANCE_WEIGHT, TEXTURE_WEIGHT]
    fixed = BIAS + fused_log_odds([position, layout, distance, texture], exponents)
    neighbours = NEIGHBOUR_WEIGHT * neighbour_mean(segments)
    similarity = segment_affinity(segments, BANDWIDTHS)
    score = fixed
    for _ in range(LEARNING_ROUNDS):
        belief = score.sigmoid()
        weights = torch.stack([belief, 1 - belief], 1)
        density = class_log_density(similarity, weights, segments.size)
        appearance = (density[:, 0] - density[:, 1]).clamp(-MAX_APPEARANCE, MAX_APPEARANCE)
        score = torch.addmv(fixed, neighbours, 2 * belief - 1)
        score.add_(appearance, alpha=APPEARANCE_WEIGHT)
    return (score / TEMPERATURE).sigmoid()


def neighbour_mean(segments: Segments) -> Tensor:
    """Return the (n, n) matrix that averages a value over each segment's adjacent segments."""
    count = len(segments.size)
    first, second = segments.pairs
    touching = segments.size.new_zeros(count, count)
    touching[first, second] = 1
    touching[second, first] = 1
    return touching / touching.sum(1, keepdim=True).clamp_min(1)


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
