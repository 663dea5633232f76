"""How sure figures are: images drawn anew inside their groups, detectors compared in pairs.

Pixels of one image are not independent, images of one group less than they look; so whole
images are drawn, inside each group, as often as the group has images. All figures of all
detectors over the same images use the same draws: what an easy or a hard draw does to both
of two detectors cancels in their difference.

Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 13 (percentiles).
"""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from roadtorch.evaluation import metrics
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.evaluation.result import Comparison, DetectorFigures, Difference, Interval
from roadtorch.evaluation.tally import Images, Part, Tally

REPLICATES = 1000

SEED = 11  # of the draws of a run


def bootstrap_weights(
    images: int, generator: torch.Generator, replicates: int = REPLICATES
) -> Tensor:
    """How often each image is drawn, int64 (replicates,images): each row sums to ``images``."""
    places = torch.randint(images, (replicates, images), generator=generator)
    return torch.zeros_like(places).scatter_add_(1, places, torch.ones_like(places))


def interval(draws: Tensor) -> Interval:
    """The 95 % percentile interval of a figure's values under every draw, float64 (replicates,).

    Draws without a value are left out. Of the difference of two figures over the same weights it
    lies above 0 where the first is larger beyond what the choice of images explains.
    """
    values = draws[~draws.isnan()]
    if not len(values):
        return Interval()
    low, high = torch.quantile(values, torch.tensor([0.025, 0.975], dtype=values.dtype))
    return Interval(float(low), float(high))


# --- the figures of a run -----------------------------------------------------------------

Draws = Mapping[str, Tensor]
"""Headline figures under every draw of the images, float64 (replicates,), by measure's key."""


def resample(
    tally: Tally, figures: DetectorFigures, measures: Sequence[Measure] = MEASURES
) -> Draws:
    """Draw images inside their groups anew, and take the headline figures of each draw.

    Thresholds stay as they were chosen. The draws, which are counted on 8-bit maps, are
    moved by what that changes in the figure of all images.
    """
    groups = [tally.kept([group]) for group in figures.counting]
    thresholds = [figures.thresholds[group] for group in figures.counting]
    generator = torch.Generator().manual_seed(SEED)
    weights = [bootstrap_weights(len(group.names), generator, REPLICATES) for group in groups]
    once = [torch.ones_like(drawing[:1]) for drawing in weights]
    kept = [measure for measure in measures if measure.interval and measure.key in figures.headline]
    coarse, draws = (_mean_over_groups(groups, thresholds, each, kept) for each in (once, weights))
    return {
        measure.key: draws[measure.key]
        + (measure.of(figures.headline) - float(coarse[measure.key]))
        for measure in kept
    }


def _mean_over_groups(
    groups: Sequence[Images],
    thresholds: Sequence[float],
    weights: Sequence[Tensor],
    measures: Sequence[Measure],
) -> dict[str, Tensor]:
    """The figures (draws,) by key, of the images of each group as often as weights say."""
    figures: dict[str, list[Tensor]] = {measure.key: [] for measure in measures}
    for group, threshold, drawing in zip(groups, thresholds, weights, strict=True):
        part = drawn(group, threshold, drawing)
        for measure in measures:
            values = measure.formula(part)
            if not isinstance(values, Tensor):
                raise TypeError(f"the formula of {measure.key} needs what draws do not have")
            figures[measure.key].append(values)
    return {key: torch.stack(values).nanmean(0) for key, values in figures.items()}


def drawn(images: Images, threshold: float, weights: Tensor) -> Part:
    """The images of one group, each as often as weights (draws,n) say, on 8-bit maps."""

    def summed(counts: Tensor) -> Tensor:
        flat = weights.to(torch.float64) @ counts.flatten(1).to(torch.float64)
        return flat.reshape(-1, *counts.shape[1:])

    road, other = (
        summed(part).round().to(torch.int64) for part in (images.road.road, images.road.other)
    )
    counts = RoadCounts(road, other)
    known = ~images.auc.isnan()
    areas, of_known = images.auc[known], weights[:, known].to(torch.float64)
    return Part(
        counts,
        Decisions(*summed(images.outcomes).unbind(1)),
        summed(images.boundary),
        None if images.layout is None else summed(images.layout),
        None if math.isnan(threshold) else metrics.decisions_at(counts, threshold),
        (of_known @ areas) / of_known.sum(1),
    )


def intervals(draws: Draws) -> dict[str, Interval]:
    """95 % intervals of the headline figures, inside [0,1]."""
    ends = {key: interval(values) for key, values in draws.items()}
    return {key: Interval(max(low, 0.0), min(high, 1.0)) for key, (low, high) in ends.items()}


def compare(
    detectors: Mapping[str, DetectorFigures],
    draws: Mapping[str, Draws],
    against: str,
    measures: Sequence[Measure] = MEASURES,
) -> Comparison:
    """Every detector less the one called ``against``, in the measures that both have."""
    shared = [
        measure
        for measure in measures
        if "compared" in measure.shown and measure.key in draws[against]
    ]
    other = detectors[against].headline
    return Comparison(
        against,
        {
            name: {
                measure.key: Difference(
                    measure.of(detectors[name].headline) - measure.of(other),
                    interval(own[measure.key] - draws[against][measure.key]),
                )
                for measure in shared
                if measure.key in own
            }
            for name, own in draws.items()
            if name != against
        },
    )
