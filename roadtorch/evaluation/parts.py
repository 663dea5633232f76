"""What measures are taken of: the counts of a drive, of a whole set, or of pictures drawn anew."""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import TypeVar

import torch
from torch import Tensor

from roadtorch.evaluation import curves, metrics
from roadtorch.evaluation.curves import Curve
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.evaluation.tally import Pictures, Tally
from roadtorch.evaluation.trust import Trusted

Sum = TypeVar("Sum", RoadCounts, Decisions, Tensor)


@dataclass(frozen=True)
class Part:
    """Counts of some pictures together, or of many draws of them: then all have (draws,…).

    chosen: the outcome at the threshold of each drive; None where there is none.
    image_auc: the mean of the single pictures' AUC, float64 (…).
    What follows in the list is not known of draws: labels, a confusion as ``layout``, of
    labels that may abstain; roc, the vertical average of the single pictures' curves;
    threshold, where there is one for all; skipped, the pictures without AUC; trusted, the
    single pictures that have a trust, None where no picture has.
    """

    road: RoadCounts
    mask: Decisions
    boundary: Tensor
    layout: Tensor | None
    chosen: Decisions | None
    image_auc: Tensor
    labels: Tensor | None = None
    roc: Curve | None = None
    threshold: float | None = None
    images: int = 0
    skipped: int = 0
    milliseconds: float = math.nan
    trusted: Trusted | None = None

    @cached_property
    def working_point(self) -> Mapping[str, Tensor]:
        """KITTI's figures where F is highest, see ``metrics.working_point``."""
        return metrics.working_point(self.road)


def counted(tally: Tally, thresholds: Mapping[str, float]) -> Part:
    """The drives that have thresholds, their counts added up."""
    pictures = tally.kept(thresholds)
    areas = [area for area in pictures.auc.tolist() if not math.isnan(area)]
    chosen = {
        group: metrics.decisions_at(tally.road[group], threshold)
        for group, threshold in thresholds.items()
        if not math.isnan(threshold)
    }
    roc = _total(tally.curve, thresholds)
    return Part(
        _sum([tally.road[group] for group in thresholds]),
        _sum([tally.mask[group] for group in thresholds]),
        _sum([tally.boundary[group] for group in thresholds]),
        _total(tally.layout, thresholds),
        _total(chosen, thresholds),
        torch.tensor(mean(areas), dtype=torch.float64),
        _total(tally.labels, thresholds),
        None if roc is None else curves.vertical_average(roc / len(areas)),
        images=len(pictures.names),
        skipped=len(pictures.names) - len(areas),
        milliseconds=1000 * statistics.median(pictures.seconds.tolist()),
        trusted=trusted(pictures),
    )


def trusted(pictures: Pictures) -> Trusted | None:
    """The pictures that have a trust and an F of the mask; None where no picture has a trust."""
    if pictures.trust.isnan().all():
        return None
    f = metrics.f_measure(pictures.mask)
    known = ~(pictures.trust.isnan() | f.isnan())
    groups = [group for group, kept in zip(pictures.groups, known.tolist(), strict=True) if kept]
    return Trusted(pictures.trust[known], f[known], groups)


def _total(sums: Mapping[str, Sum], groups: Mapping[str, float]) -> Sum | None:
    known = [sums[group] for group in groups if group in sums]
    return _sum(known) if known else None


def _sum(counts: Sequence[Sum]) -> Sum:
    return reduce(lambda one, other: one + other, counts)


def taken_together(pictures: Pictures, thresholds: Mapping[str, float]) -> Part:
    """Pictures of any drives, their counts added up, on 8-bit maps: figures of shape (1,).

    thresholds: those of their drives. Labels that may abstain are not known.
    """
    once = torch.ones(1, len(pictures.names), dtype=torch.int64)
    chosen = {
        group: metrics.decisions_at(metrics.pool(pictures.road, once * own), threshold)
        for group, threshold in thresholds.items()
        if not math.isnan(threshold)
        and (own := torch.tensor([name == group for name in pictures.groups])).any()
    }
    known = ~pictures.auc.isnan()
    rates = curves.vertical_sample(
        RoadCounts(pictures.road.road[known], pictures.road.other[known])
    )
    return replace(
        drawn(pictures, math.nan, once),
        chosen=_total(chosen, thresholds),
        roc=curves.vertical_average(rates.mean(0)) if known.any() else None,
        images=len(pictures.names),
        skipped=int((~known).sum()),
        milliseconds=1000 * statistics.median(pictures.seconds.tolist()),
        trusted=trusted(pictures),
    )


def drawn(pictures: Pictures, threshold: float, weights: Tensor) -> Part:
    """The pictures of one drive, each as often as weights (draws,n) say, on 8-bit maps."""
    road = metrics.pool(pictures.road, weights)
    known = ~pictures.auc.isnan()
    areas, of_known = pictures.auc[known], weights[:, known].to(torch.float64)
    mask = torch.stack(
        [
            pictures.mask.true_positive,
            pictures.mask.false_positive,
            pictures.mask.false_negative,
            pictures.mask.true_negative,
        ],
        1,
    )
    return Part(
        road,
        Decisions(*_weighted(mask, weights).unbind(1)),
        _weighted(pictures.boundary, weights),
        None if pictures.layout is None else _weighted(pictures.layout, weights),
        None if math.isnan(threshold) else metrics.decisions_at(road, threshold),
        (of_known @ areas) / of_known.sum(1),
    )


def _weighted(counts: Tensor, weights: Tensor) -> Tensor:
    """Sums of counts (n,…) over the pictures, as often as each is drawn: float64 (draws,…)."""
    flat = weights.to(torch.float64) @ counts.flatten(1).to(torch.float64)
    return flat.reshape(-1, *counts.shape[1:])


def mean(values: Sequence[float]) -> float:
    """The mean of the defined values; NaN when there is none."""
    defined = [value for value in values if not math.isnan(value)]
    return sum(defined) / len(defined) if defined else math.nan
