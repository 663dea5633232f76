"""From counts to figures: of each group, of all together, of conditions, and of single pictures."""

import math
import statistics
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import torch
from torch import Tensor

from roadtorch.data.dataset import Item
from roadtorch.evaluation import curves, metrics
from roadtorch.evaluation.curves import Curve
from roadtorch.evaluation.measure import Figures, Measure, Part, Trusted
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.methods import Method
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.evaluation.result import DetectorFigures, PicturesByF
from roadtorch.evaluation.tally import WHOLE, Pictures, Tally
from roadtorch.evaluation.thresholds import choose_thresholds, shared_threshold

SHOWN = 10  # pictures of each kind in metrics.json

QUANTILES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)


def summarise(
    method: Method,
    tally: Tally,
    given: float | None = None,
    measures: Sequence[Measure] = MEASURES,
    left_out: Collection[str] = (),
    conditions: Mapping[str, Sequence[Item]] | None = None,
) -> DetectorFigures:
    """All figures of one detector but its intervals.

    given: a threshold chosen elsewhere. left_out: groups that count in nothing but their own.
    conditions: pictures by condition, which have figures together, whatever groups they are of.
    """
    source, thresholds = choose_thresholds(tally.road, method.threshold, given, left_out)
    counting = {group: one for group, one in thresholds.items() if group not in left_out}
    parts = {
        group: figures_of(replace(counted(tally, {group: one}), threshold=one), measures)
        for group, one in thresholds.items()
    }
    of_condition = {
        name: tally.named({item.name for item in items})
        for name, items in (conditions or {}).items()
    }
    whole = DetectorFigures(
        method,
        parts.get(WHOLE, {}),
        conditions={
            name: figures_of(taken_together(pictures, thresholds), measures)
            for name, pictures in of_condition.items()
            if pictures.names
        },
        thresholds=thresholds,
        threshold_from=source,
        best_threshold=shared_threshold({group: tally.road[group] for group in counting}),
        pictures_by_f=chosen_pictures(tally.kept(counting), thresholds, SHOWN),
    )
    if list(parts) == [WHOLE]:
        return whole
    groups = {group: parts[group] for group in counting}
    pooled = figures_of(counted(tally, counting), measures)
    return replace(
        whole,
        headline=over_groups(groups, pooled, measures),
        groups=groups,
        left_out={group: figures for group, figures in parts.items() if group not in counting},
        pooled=pooled,
    )


def figures_of(part: Part, measures: Sequence[Measure]) -> Figures:
    """The measures of a part, without those that it does not have."""
    values = {one.key: one.formula(part) for one in measures}
    return {
        key: value.item() if isinstance(value, Tensor) else value
        for key, value in values.items()
        if value is not None
    }


def over_groups(
    groups: Mapping[str, Figures], pooled: Figures, measures: Sequence[Measure]
) -> Figures:
    """What stands above the figures of the groups: means, or those of all pictures together."""
    figures = {}
    for one in measures:
        if one.key in pooled and one.over_groups == "whole":
            figures[one.key] = pooled[one.key]
        elif one.key in pooled and one.over_groups == "mean":
            figures[one.key] = mean([one.of(group) for group in groups.values()])
    return figures


def mean(values: Sequence[float]) -> float:
    """The mean of the defined values; NaN when there is none."""
    defined = [value for value in values if not math.isnan(value)]
    return sum(defined) / len(defined) if defined else math.nan


# --- what measures are taken of ----------------------------------------------------------


def counted(tally: Tally, thresholds: Mapping[str, float]) -> Part:
    """The groups that have thresholds, their counts added up."""
    pictures = tally.kept(thresholds)
    areas = [area for area in pictures.auc.tolist() if not math.isnan(area)]
    road, mask, boundary, layout, labels = (
        tally.total(kind, thresholds) for kind in ("road", "mask", "boundary", "layout", "labels")
    )
    if road is None or mask is None or boundary is None:
        raise ValueError(f"nothing is counted of {', '.join(thresholds)}")
    by_group = {group: tally.road[group] for group in thresholds}
    return Part(
        RoadCounts(*road),
        Decisions(*mask),
        boundary,
        layout,
        _at_thresholds(by_group, thresholds),
        torch.tensor(mean(areas), dtype=torch.float64),
        labels,
        vertical_roc(tally, thresholds),
        images=len(pictures.names),
        skipped=len(pictures.names) - len(areas),
        milliseconds=1000 * statistics.median(pictures.seconds.tolist()),
        trusted=trusted(pictures),
    )


def vertical_roc(tally: Tally, groups: Collection[str]) -> Curve | None:
    """The vertical average of the single pictures' ROC; None where none has any."""
    summed, known = tally.total("curve", groups), ~tally.kept(groups).auc.isnan()
    return None if summed is None else curves.vertical_average(summed / int(known.sum()))


def _at_thresholds(
    counts: Mapping[str, RoadCounts], thresholds: Mapping[str, float]
) -> Decisions | None:
    """The outcomes of the groups, each at its threshold, together; None where none has any."""
    outcomes = [
        metrics.decisions_at(counts[group], threshold)
        for group, threshold in thresholds.items()
        if group in counts and not math.isnan(threshold)
    ]
    return reduce(add, outcomes) if outcomes else None


def trusted(pictures: Pictures) -> Trusted | None:
    """The pictures that have a trust and an F of the mask; None where no picture has a trust."""
    if pictures.trust.isnan().all():
        return None
    f = metrics.f_measure(pictures.mask)
    known = ~(pictures.trust.isnan() | f.isnan())
    groups = [group for group, kept in zip(pictures.groups, known.tolist(), strict=True) if kept]
    return Trusted(pictures.trust[known], f[known], groups)


def taken_together(pictures: Pictures, thresholds: Mapping[str, float]) -> Part:
    """Pictures of any groups, their counts added up, on 8-bit maps: figures of shape (1,).

    thresholds: those of their groups. Labels that may abstain are not known.
    """
    once = torch.ones(1, len(pictures.names), dtype=torch.int64)
    by_group = {
        group: metrics.pool(pictures.road, once * pictures.of_group(group))
        for group in dict.fromkeys(pictures.groups)
    }
    known = ~pictures.auc.isnan()
    rates = curves.vertical_sample(
        RoadCounts(pictures.road.road[known], pictures.road.other[known])
    )
    return replace(
        drawn(pictures, math.nan, once),
        chosen=_at_thresholds(by_group, thresholds),
        roc=curves.vertical_average(rates.mean(0)) if known.any() else None,
        images=len(pictures.names),
        skipped=int((~known).sum()),
        milliseconds=1000 * statistics.median(pictures.seconds.tolist()),
        trusted=trusted(pictures),
    )


def drawn(pictures: Pictures, threshold: float, weights: Tensor) -> Part:
    """The pictures of one group, each as often as weights (draws,n) say, on 8-bit maps."""
    road = metrics.pool(pictures.road, weights)
    known = ~pictures.auc.isnan()
    areas, of_known = pictures.auc[known], weights[:, known].to(torch.float64)
    return Part(
        road,
        Decisions(*_weighted(pictures.outcomes, weights).unbind(1)),
        _weighted(pictures.boundary, weights),
        None if pictures.layout is None else _weighted(pictures.layout, weights),
        None if math.isnan(threshold) else metrics.decisions_at(road, threshold),
        (of_known @ areas) / of_known.sum(1),
    )


def _weighted(counts: Tensor, weights: Tensor) -> Tensor:
    """Sums of counts (n,…) over the pictures, as often as each is drawn: float64 (draws,…)."""
    flat = weights.to(torch.float64) @ counts.flatten(1).to(torch.float64)
    return flat.reshape(-1, *counts.shape[1:])


# --- single pictures ---------------------------------------------------------------------


@dataclass(frozen=True)
class PictureRow:
    """One picture as one detector saw it: a row of images.csv; NaN where undefined.

    threshold: of its group; f: there, of the 8-bit map; f_mask, iou_mask: of the detector's
    own mask; trust: its expected F, by the detector; ms: the time of detect.
    """

    image: str
    group: str
    detector: str
    auc: float
    maxf: float
    threshold: float
    f: float
    f_mask: float
    iou_mask: float
    trust: float
    ms: float


def picture_rows(name: str, tally: Tally, figures: DetectorFigures) -> list[PictureRow]:
    """A row for every picture that one detector has seen."""
    kept = tally.kept()
    columns = (
        kept.auc.tolist(),
        kept.max_f.tolist(),
        [figures.thresholds[group] for group in kept.groups],
        image_f(kept, figures.thresholds).tolist(),
        metrics.f_measure(kept.mask).tolist(),
        metrics.iou(kept.mask).tolist(),
        kept.trust.tolist(),
        (1000 * kept.seconds).tolist(),
    )
    return [
        PictureRow(image, group, name, *values)
        for image, group, *values in zip(kept.names, kept.groups, *columns, strict=True)
    ]


def image_f(pictures: Pictures, thresholds: Mapping[str, float]) -> Tensor:
    """F of each picture at its group's threshold, of its 8-bit map, float64 (n,).

    NaN without road or threshold.
    """
    f = torch.full((len(pictures.names),), math.nan, dtype=torch.float64)
    for group, threshold in thresholds.items():
        if not math.isnan(threshold):
            own = pictures.of_group(group)
            counts = RoadCounts(pictures.road.road[own], pictures.road.other[own])
            outcome = metrics.decisions_at(counts, threshold)
            has_road = outcome.true_positive + outcome.false_negative > 0
            f[own] = metrics.f_measure(outcome).where(has_road, torch.nan)
    return f


def chosen_pictures(pictures: Pictures, thresholds: Mapping[str, float], count: int) -> PicturesByF:
    """Quantiles of F over the pictures with road, and the best, median and worst ``count``."""
    values = image_f(pictures, thresholds).tolist()
    known = [(f, name) for f, name in zip(values, pictures.names, strict=True) if not math.isnan(f)]
    if not known:
        return PicturesByF()
    order = sorted(known, key=lambda pair: (-pair[0], pair[1]))
    begin = max((len(order) - count) // 2, 0)
    shares = torch.tensor(QUANTILES, dtype=torch.float64)
    of_all = torch.tensor([value for value, _ in order], dtype=torch.float64)
    return PicturesByF(
        dict(zip(QUANTILES, of_all.quantile(shares).tolist(), strict=True)),
        order[:count],
        order[begin : begin + count],
        order[::-1][:count],
    )
