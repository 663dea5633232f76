"""Naive Bayes: what was learned off line and what this picture shows, in one probability.

``likelihood_product`` is P2's eq. 4: prior times likelihoods, no model of the background. The
rest is ours, after it: every cue is a likelihood in [0,1], read as p(road | cue) under even
odds, so that cues multiply as odds, L / (1-L): what speaks for the background speaks too. The
two can rank pixels the other way round: 0.9 and 0.3 have the product 0.27 and the odds 3.9,
0.6 and 0.6 the product 0.36 and the odds 2.3. Over segments one more cue is learned from the
others: what the road of this very picture looks like (ours).
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.settings import Settings
from roadtorch.superpixels.features import Bandwidths, Segments, class_log_density, likeness

SUREST = 1e-4
"""Likelihoods count as at least this far from 0 and 1: no cue alone can veto the others."""

STRONGEST_LOOK = 3.0
"""The look says at most this much (log odds): paint on the road looks like nothing else on it,
and what surrounds it must be able to say so."""


class RoadPlace(Settings):
    """Where the road tends to be: a soft triangle. Shares of the picture's height and width."""

    weight: float = Field(default=0.4, ge=0, le=10, description="weight of the prior; 0 is uniform")
    apex: float = Field(
        default=0.69, ge=-1, le=1, description="row at which the half width is `narrow`"
    )
    narrow: float = Field(
        default=0.07, ge=-1, le=1, description="half width of the road at the apex"
    )
    spread: float = Field(
        default=1.1, ge=0, le=10, description="half width gained per height below it"
    )
    softness: float = Field(
        default=0.11, gt=0, le=10, description="widths over which the road fades"
    )


class Exponents(Settings):
    """How much each cue is trusted: exponents of the odds L / (1-L); ours (see the module)."""

    layout: float = Field(default=0.44, ge=0, le=10, description="the ground of the scene layout")
    distance: float = Field(default=1.0, ge=0, le=10, description="the distance from the seed area")
    texture: float = Field(
        default=2.0, ge=0, le=10, description="the uniformity of the fused plane"
    )
    look: float = Field(default=2.0, ge=0, le=10, description="the look learned in this picture")
    neighbours: float = Field(
        default=6.0, ge=0, le=10, description="what the neighbouring segments are"
    )


class SegmentRoadSettings(Settings):
    """How the cues of a picture's segments become p(road)."""

    renamed: ClassVar[Mapping[str, str]] = {"weights": "exponents"}

    place: RoadPlace = RoadPlace()
    exponents: Exponents = Exponents()
    reach: float = Field(
        default=1.7,
        gt=0,
        le=1000,
        description="faint borders on the way from the seed area that leave it open",
    )
    bandwidths: Bandwidths = Bandwidths(
        lightness=0.085, chroma=0.01, gradient=0.07, contrast=0.9, row=0.1, column=3.0
    )
    bias: float = Field(default=-1.8, ge=-20, le=20, description="log odds of road before any cue")
    temperature: float = Field(default=6.0, gt=0, le=100, description="divides the final log odds")
    rounds: int = Field(
        default=4, ge=0, le=100, description="rounds of learning the look of the road"
    )


def likelihood_product(prior: Tensor, likelihoods: Sequence[Tensor]) -> Tensor:
    """p(R | cues) up to a constant: p(R) · Π L, P2 eq. 4. All (H,W) in [0,1].

    "Only considerations about the road are taken into account" (P2, section 5): nothing is
    said of the background, so the result is no probability, and is compared with a threshold.
    A prior counts relative to its largest value: a uniform one changes nothing.
    """
    found = prior / prior.max()
    for likelihood in likelihoods:
        found = found * likelihood
    return found


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


def road_place(row: Tensor, column: Tensor, place: RoadPlace) -> Tensor:
    """Prior p(road) at rows and columns from 0 to 1: a triangle with soft sides, ahead (ours)."""
    half = place.narrow + place.spread * (row - place.apex).clamp_min(0)
    return ((half - (column - 0.5).abs()) / place.softness).sigmoid()


def segment_road(
    segments: Segments,
    layout: Tensor,
    distance: Tensor,
    texture: Tensor,
    settings: SegmentRoadSettings,
    further: Tensor | float = 0.0,
) -> Tensor:
    """p(road) of each segment (n,) from its likelihoods (n,) by layout, distance and texture.

    further: log odds (n,) of whatever else is known, added as they are.

    Naive Bayes over the cues gives a first belief; then, in rounds, kernel densities of road
    and background are learned from the belief and join as one more cue, as do the neighbours.
    """
    exponents = settings.exponents
    place = road_place(segments.row, segments.column, settings.place)
    known = (
        settings.bias
        + further
        + fused_log_odds(
            [place, layout, distance, texture],
            [settings.place.weight, exponents.layout, exponents.distance, exponents.texture],
        )
    )
    alike = likeness(segments, settings.bandwidths)
    around = exponents.neighbours * neighbour_mean(segments)
    score = known
    for _ in range(settings.rounds):
        belief = score.sigmoid()
        density = class_log_density(alike, torch.stack([belief, 1 - belief], 1), segments.size)
        look = (density[:, 0] - density[:, 1]).clamp(-STRONGEST_LOOK, STRONGEST_LOOK)
        score = torch.addmv(known, around, 2 * belief - 1).add_(look, alpha=exponents.look)
    return (score / settings.temperature).sigmoid()


def neighbour_mean(segments: Segments) -> Tensor:
    """(n,n) matrix that averages a value over the segments that share a border with each."""
    count = len(segments.size)
    one, two = segments.pairs
    touching = segments.size.new_zeros(count, count)
    touching[one, two] = 1
    touching[two, one] = 1
    return touching / touching.sum(1, keepdim=True).clamp_min(1)
