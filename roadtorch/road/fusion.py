"""Naive Bayes: what was learned off line and what this image shows, in one probability.

``likelihood_product`` is P2's eq. 4: prior times likelihoods, no model of the background. The
rest is ours, after it: every cue is a likelihood in [0,1], read as p(road | cue) under even
odds, so that cues multiply as odds, L / (1-L): what speaks for the background speaks too. The
two can rank pixels the other way round: 0.9 and 0.3 have the product 0.27 and the odds 3.9,
0.6 and 0.6 the product 0.36 and the odds 2.3. Over segments one more cue is learned from the
others: what the road of this very image looks like (ours).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.imaging.levels import otsu_threshold
from roadtorch.imaging.segments import Bandwidths, Segments, class_log_density, likeness

SUREST = 1e-4
"""Likelihoods count as at least this far from 0 and 1: no cue alone can veto the others."""

STRONGEST_LOOK = 3.0
"""The look says at most this much (log odds): paint on the road looks like nothing else on it,
and what surrounds it must be able to say so."""


class RoadPlace(NamedTuple):
    """Where the road tends to be: a soft triangle. Shares of the image's height and width.

    weight: of the prior; 0 is uniform. apex: row at which the half width is ``narrow``. spread:
    half width gained per height below it. softness: widths over which the road fades.
    """

    weight: float = 0.4
    apex: float = 0.69
    narrow: float = 0.07
    spread: float = 1.1
    softness: float = 0.11


class Exponents(NamedTuple):
    """How much each cue is trusted: exponents of the odds L / (1-L); ours (see the module).

    layout: the ground of the scene layout. distance: from the seed area. texture: the uniformity
    of the fused plane. look: learned in this image. neighbours: what the segments beside are.
    """

    layout: float = 0.44
    distance: float = 1.0
    texture: float = 2.0
    look: float = 2.0
    neighbours: float = 6.0


class RoadRules(NamedTuple):
    """How the cues of an image's segments become p(road).

    reach: faint borders on the way from the seed area that leave it open. bias: log odds of road
    before any cue. temperature: divides the final log odds. rounds: of learning the look.
    Half or twice a weight moves MaxF by less than .005.
    """

    place: RoadPlace = RoadPlace()
    exponents: Exponents = Exponents()
    reach: float = 1.7
    bandwidths: Bandwidths = Bandwidths(0.085, 0.01, 0.07, 0.9, 0.1, 3.0)
    bias: float = -1.8
    temperature: float = 6.0
    rounds: int = 4


RULES = RoadRules()


def likelihood_product(prior: Tensor, likelihoods: Sequence[Tensor]) -> Tensor:
    """p(R | cues) up to a constant: p(R) · Π L, P2 eq. 4. All (H,W) in [0,1].

    "Only considerations about the road are taken into account" (P2, section 5): nothing is
    said of the background, so the result is no probability, and is compared with a threshold.
    A prior counts relative to its largest value: a uniform one changes nothing.
    """
    product = prior / prior.max()
    for likelihood in likelihoods:
        product = product * likelihood
    return product


def log_odds(likelihood: Tensor) -> Tensor:
    """log(L / (1-L)) of likelihoods in [0,1], kept finite (see ``SUREST``)."""
    return torch.logit(likelihood, eps=SUREST)


def fused_log_odds(likelihoods: Sequence[Tensor], weights: Sequence[float]) -> Tensor:
    """Σ W · log(L / (1-L)) of likelihoods of one shape, in [0,1]; 0.5 says nothing.

    Naive Bayes with a model of the background: its sigmoid is Π Lᵂ / (Π Lᵂ + Π (1-L)ᵂ). With
    weights 1 that is not P2's eq. 4, which leaves the background out (``likelihood_product``).
    Summed as log odds: no product of small numbers underflows.
    """
    first, *further = zip(likelihoods, weights, strict=True)
    total = log_odds(first[0]).mul_(first[1])
    for likelihood, weight in further:
        total.add_(log_odds(likelihood), alpha=weight)
    return total


def road_place(row: Tensor, column: Tensor, place: RoadPlace = RULES.place) -> Tensor:
    """Prior p(road) at rows and columns from 0 to 1: a triangle with soft sides, ahead (ours)."""
    half = place.narrow + place.spread * (row - place.apex).clamp_min(0)
    return ((half - (column - 0.5).abs()) / place.softness).sigmoid()


def seed_log_odds(segments: Segments, ground: Tensor) -> Tensor:
    """Log odds (n,) that segments are road by place and by the layout's ground (n,) alone."""
    place = road_place(segments.row, segments.column)
    return fused_log_odds([ground, place], [RULES.exponents.layout, RULES.place.weight])


def segment_road(
    segments: Segments,
    layout: Tensor,
    distance: Tensor,
    texture: Tensor,
    further: Tensor | float = 0.0,
    rules: RoadRules = RULES,
) -> Tensor:
    """p(road) of each segment (n,) from its likelihoods (n,) by layout, distance and texture.

    further: log odds (n,) of whatever else is known, added as they are.

    Naive Bayes over the cues gives a first belief; then, in rounds, kernel densities of road
    and background are learned from the belief and join as one more cue, as do the neighbours.
    """
    exponents = rules.exponents
    place = road_place(segments.row, segments.column, rules.place)
    known = (
        rules.bias
        + further
        + fused_log_odds(
            [place, layout, distance, texture],
            [rules.place.weight, exponents.layout, exponents.distance, exponents.texture],
        )
    )
    around = exponents.neighbours * neighbour_mean(segments)
    alike = likeness(segments, rules.bandwidths)
    score = known
    for _ in range(rules.rounds):
        belief = score.sigmoid()
        density = class_log_density(alike, torch.stack([belief, 1 - belief], 1), segments.size)
        look = (density[:, 0] - density[:, 1]).clamp(-STRONGEST_LOOK, STRONGEST_LOOK)
        score = torch.addmv(known, around, 2 * belief - 1).add_(look, alpha=exponents.look)
    return (score / rules.temperature).sigmoid()


def neighbour_mean(segments: Segments) -> Tensor:
    """(n,n) matrix that averages a value over the segments that share a border with each."""
    count = len(segments.size)
    first, second = segments.pairs
    touching = segments.size.new_zeros(count, count)
    touching[first, second] = 1
    touching[second, first] = 1
    return touching / touching.sum(1, keepdim=True).clamp_min(1)


def centred_odds(odds: Tensor, centre: float, own: float) -> Tensor:
    """Log odds (…) of one image less those that part road from background.

    These are between ``centre``, the same for all images, and the image's own (Otsu), by
    the share ``own``. The best threshold differs from camera to camera and needs no label to
    be seen; but Otsu's alone takes too much for a narrow road, so it is not trusted whole. Ours.
    """
    if not own:
        return odds - centre
    return odds - torch.lerp(odds.new_tensor(centre), otsu_threshold(odds), own)


# --- location priors ------------------------------------------------------------------


TRIANGLE_APEX = 0.45
"""Where the triangle of ``prior_triangle`` begins, in heights from the top: a usual horizon."""

TRIANGLE_BASE = 1.16
"""Width of its base on the bottom edge, in widths: the road leaves the image at the sides."""


def prior_uniform(height: int, width: int) -> Tensor:
    """0.5 everywhere, float32 (H,W): every pixel may be road (the uniform prior of P2)."""
    return torch.full((height, width), 0.5)


def prior_rows(height: int, width: int) -> Tensor:
    """Row / height, float32 (H,W), pixel centres: the lower, the more likely road."""
    rows = (torch.arange(height, dtype=torch.float32) + 0.5) / height
    return rows[:, None].expand(height, width).contiguous()


def prior_triangle(height: int, width: int) -> Tensor:
    """1 in a triangle with its base on the bottom edge, 0 elsewhere: float32 (H,W).

    A straight road ahead, ours: apex in the middle at ``TRIANGLE_APEX``, base ``TRIANGLE_BASE``.
    MaxF on the development drives 0001TP, 0006R0 and 0016E5 of CamVid: 0.750, 0.842, 0.863; IDD:
    0.811.
    """
    rows = (torch.arange(height, dtype=torch.float32)[:, None] + 0.5) / height
    columns = (torch.arange(width, dtype=torch.float32) + 0.5) / width
    reach = TRIANGLE_BASE / 2 * (rows - TRIANGLE_APEX) / (1 - TRIANGLE_APEX)
    return ((columns - 0.5).abs() <= reach).to(torch.float32)


Prior = Callable[[int, int], Tensor]
"""A prior p(road) float32 (H,W) in [0,1] by height and width."""

PRIORS: dict[str, Prior] = {
    "uniform": prior_uniform,
    "rows": prior_rows,
    "triangle": prior_triangle,
}
