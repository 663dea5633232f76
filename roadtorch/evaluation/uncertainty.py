"""Bootstrap intervals: images are resampled within their groups, detectors compared in pairs.

Pixels of one image are not independent, so whole images are drawn, within each group, as often as
the group has images. All scores of all detectors over the same images use the same draws: the
effect of an easy or a hard draw on both of two detectors cancels in their difference.

Percentiles of replicates are too close together for few values, such as three drives or five
seeds: their weights are drawn so that the mean of any values has Student's t distribution.

Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 13 (percentiles).
"""

from collections.abc import Mapping, Sequence

import torch
from scipy.special import stdtrit
from torch import Tensor

from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.metrics import ConfusionCounts, f_measure
from roadtorch.evaluation.result import Comparison, DetectorScores, Difference, Interval
from roadtorch.evaluation.tally import ImageTable, Tally, pool

REPLICATES = 1000
BOOTSTRAP_SEED = 11


def bootstrap_weights(images: int, generator: torch.Generator, count: int = REPLICATES) -> Tensor:
    """Draw how often each image counts, int64 (count, images): each row sums to ``images``."""
    indices = torch.randint(images, (count, images), generator=generator)
    return torch.zeros_like(indices).scatter_add_(1, indices, torch.ones_like(indices))


def sample_weights(groups: Sequence[str], generator: torch.Generator) -> Tensor:
    """Return weights of images of groups, float64 (1 + ``REPLICATES``, n): ones, then replicates'.

    Each group has as many images in a replicate as it has.
    """
    weights = torch.ones(1 + REPLICATES, len(groups), dtype=torch.float64)
    for group in sorted(set(groups)):
        members = torch.tensor([name == group for name in groups])
        draws = bootstrap_weights(int(members.sum()), generator, REPLICATES)
        weights[1:, members] = draws.to(torch.float64)
    return weights


def student_weights(
    count: int, generator: torch.Generator, replicates: int | None = None
) -> Tensor:
    """Draw weights of few values, float64 (replicates, count): each row sums to ``count``.

    The weighted mean of values is their mean plus their standard error times a t of count - 1
    degrees of freedom, so that a percentile interval is Student's; ours. Weights may be negative.
    """
    shape = (REPLICATES if replicates is None else replicates, count)
    normal = torch.randn(shape, generator=generator, dtype=torch.float64)
    further = torch.randn((shape[0], count - 1), generator=generator, dtype=torch.float64)
    scale = (count / further.square().sum(1, keepdim=True)).sqrt()
    return 1 + (normal - normal.mean(1, keepdim=True)) * (scale if count > 1 else 0)


def pooled_f(counts: Tensor, weights: Tensor) -> Tensor:
    """Compute F of counts (n, 4) as in ``ConfusionCounts``, pooled by weights (replicates, n)."""
    return f_measure(ConfusionCounts(*(weights @ counts.to(weights)).unbind(1)))


def percentile_interval(values: Tensor) -> Interval:
    """Return the 95 % percentile interval of a score over replicates, float64 (replicates,).

    NaNs are ignored. For a difference of two scores over the same weights, an interval above 0
    means that the first is larger by more than the choice of images explains.
    """
    values = values[~values.isnan()]
    if not len(values):
        return Interval()
    low, high = torch.quantile(values, torch.tensor([0.025, 0.975], dtype=values.dtype))
    return Interval(float(low), float(high))


def mean_interval(values: Tensor) -> Interval:
    """Return the 95 % interval of the mean of values (n,): Student's t; one value has none."""
    if len(values) < 2:
        return Interval()
    mean, error = float(values.double().mean()), float(values.double().std()) / len(values) ** 0.5
    half_width = float(stdtrit(len(values) - 1, 0.975)) * error
    return Interval(mean - half_width, mean + half_width)


# --- the scores of an evaluation -----------------------------------------------------------------

Replicates = Mapping[str, Tensor]
"""Headline scores of every replicate, float64 (replicates,), by measure's key."""


def bootstrap(
    tally: Tally, scores: DetectorScores, measures: Sequence[Measure] = MEASURES
) -> Replicates:
    """Resample images within their groups, and compute the headline scores of each replicate.

    Thresholds stay as they were chosen. Replicates are counted on 8-bit maps; they are shifted by
    the difference that this makes to the score of all images.
    """
    groups = [tally.table([group]) for group in scores.counted_groups]
    thresholds = [scores.thresholds[group] for group in scores.counted_groups]
    generator = torch.Generator().manual_seed(BOOTSTRAP_SEED)
    weights = [sample_weights(group.groups, generator) for group in groups]  # all images first
    measures = [m for m in measures if m.interval and m.key in scores.headline]
    coarse = _mean_over_groups(groups, thresholds, weights, measures)
    shifts = {m.key: m.get(scores.headline) - float(coarse[m.key][0]) for m in measures}
    return {key: coarse[key][1:] + shift for key, shift in shifts.items()}


def _mean_over_groups(
    groups: Sequence[ImageTable],
    thresholds: Sequence[float],
    weights: Sequence[Tensor],
    measures: Sequence[Measure],
) -> dict[str, Tensor]:
    """Return the scores (replicates,) by key, with weights for the images of each group."""
    scores: dict[str, list[Tensor]] = {measure.key: [] for measure in measures}
    for images, threshold, counts in zip(groups, thresholds, weights, strict=True):
        part = pool(images, {images.groups[0]: threshold}, counts)
        for measure in measures:
            values = measure.formula(part)
            if isinstance(values, Tensor):  # a group may lack a score, such as that of layouts
                scores[measure.key].append(values)
    if absent := [key for key, values in scores.items() if not values]:
        raise TypeError(f"the formula of {absent[0]} uses counts that bootstrap replicates lack")
    return {key: torch.stack(values).nanmean(0) for key, values in scores.items()}


def score_intervals(replicates: Replicates) -> dict[str, Interval]:
    """Return 95 % intervals of the headline scores, clipped to [0, 1]."""
    ends = {key: percentile_interval(values) for key, values in replicates.items()}
    return {key: Interval(max(low, 0.0), min(high, 1.0)) for key, (low, high) in ends.items()}


def compare_detectors(
    detectors: Mapping[str, DetectorScores],
    replicates: Mapping[str, Replicates],
    against: str,
    measures: Sequence[Measure] = MEASURES,
) -> Comparison:
    """Return the difference of each detector to ``against``, in the measures that both have."""
    shared = [m for m in measures if "compared" in m.tables and m.key in replicates[against]]
    reference = detectors[against].headline
    return Comparison(
        against,
        {
            name: {
                measure.key: Difference(
                    measure.get(detectors[name].headline) - measure.get(reference),
                    percentile_interval(values[measure.key] - replicates[against][measure.key]),
                )
                for measure in shared
                if measure.key in values
            }
            for name, values in replicates.items()
            if name != against
        },
    )
