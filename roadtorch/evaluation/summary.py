"""From counts to figures: of each group, of all together, of conditions, and of single pictures."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from roadtorch.data.dataset import Item
from roadtorch.evaluation import metrics
from roadtorch.evaluation.measure import Figures, Measure, Part
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.methods import Method
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.result import DetectorFigures, PicturesByF
from roadtorch.evaluation.tally import WHOLE, Pictures, Tally, counted, taken_together
from roadtorch.evaluation.thresholds import choose_thresholds

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
    chosen = choose_thresholds(tally.road, method.threshold, given, left_out)
    thresholds = chosen.thresholds
    counting = {group: one for group, one in thresholds.items() if group not in left_out}
    parts = {
        group: replace(counted(tally, {group: one}), threshold=one)
        for group, one in thresholds.items()
    }
    of_condition = {
        name: tally.named({item.name for item in items})
        for name, items in (conditions or {}).items()
    }
    together = {
        name: taken_together(pictures, thresholds)
        for name, pictures in of_condition.items()
        if pictures.names
    }
    is_whole = list(parts) == [WHOLE]
    pooled = {} if is_whole else figures_of(counted(tally, counting), measures)
    figures = {group: figures_of(part, measures) for group, part in parts.items()}
    groups = {} if is_whole else {group: figures[group] for group in counting}
    return DetectorFigures(
        method,
        figures[WHOLE] if is_whole else over_groups(groups, pooled, measures),
        groups=groups,
        pooled=pooled,
        left_out={group: one for group, one in figures.items() if group not in counting},
        conditions={name: figures_of(part, measures) for name, part in together.items()},
        thresholds=thresholds,
        threshold_from=chosen.source,
        best_threshold=chosen.best,
        pictures_by_f=chosen_pictures(tally.kept(counting), thresholds, SHOWN),
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
