"""From counts to figures: by drive, their means, thresholds chosen on other drives, intervals."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from roadtorch.evaluation import metrics
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.evaluation.runner import WHOLE, ImageRow, Tally

SEED = 11  # of the bootstrap's draws
REPLICATES = 1000
AVERAGED = ("auc_pooled", "auc_mean", "maxf", "ap", "iou", "f", "precision", "recall", "iou_mask")


# --- thresholds -------------------------------------------------------------------------


def shared_threshold(groups: Mapping[str, RoadCounts]) -> float:
    """The threshold with the highest F, averaged over drives; the lowest of equals.

    NaN when no drive has road.
    """
    curves = [metrics.f_curve(counts) for counts in groups.values() if counts.road.sum() > 0]
    return float(metrics.best_threshold(torch.stack(curves).mean(0))[1]) if curves else math.nan


def held_out_thresholds(groups: Mapping[str, RoadCounts]) -> dict[str, float]:
    """For every drive the threshold that the other drives choose; it never sees its own."""
    return {
        group: shared_threshold({name: groups[name] for name in groups if name != group})
        for group in groups
    }


def choose_thresholds(
    groups: Mapping[str, RoadCounts], default: float, given: float | None
) -> tuple[str, dict[str, float]]:
    """Where the thresholds come from, in words, and one for every drive."""
    if given is not None:
        return "an earlier run", dict.fromkeys(groups, given)
    if len(groups) > 1:
        return "the other drives", held_out_thresholds(groups)
    return "the detector's default", dict.fromkeys(groups, default)


# --- figures ----------------------------------------------------------------------------


def summarise(tally: Tally, default: float, given: float | None = None) -> dict[str, Any]:
    """All figures of one detector, as metrics.json has them.

    default: the detector's own threshold. given: a threshold chosen elsewhere.
    """
    source, thresholds = choose_thresholds(tally.road, default, given)
    groups = {group: _group_figures(tally, group, thresholds[group]) for group in tally.road}
    figures: dict[str, Any] = {
        key: _mean([group[key] for group in groups.values()]) for key in AVERAGED
    }
    figures["maxf_threshold"] = shared_threshold(tally.road)
    figures["threshold_from"] = source
    figures["images"] = len(tally.rows)
    figures["auc_images_skipped"] = sum(math.isnan(row.auc) for row in tally.rows)
    figures["ms_per_image"] = tally.milliseconds()
    figures["ci95"] = intervals(tally.rows, thresholds, figures)
    figures["images_by_f"] = _extremes(tally.rows, thresholds)
    if tally.layout:
        figures["layout"] = _layout_means(tally.layout, tally.labels)
    if list(groups) == [WHOLE]:
        return {**figures, "threshold": groups[WHOLE]["threshold"]}
    return {**figures, "groups": groups}


def _group_figures(tally: Tally, group: str, threshold: float) -> dict[str, Any]:
    counts = tally.road[group]
    rows = [row for row in tally.rows if row.group == group]
    best, where = metrics.max_f(counts)
    chosen = metrics.decisions_at(counts, threshold) if not math.isnan(threshold) else None
    figures: dict[str, Any] = {
        "images": len(rows),
        "auc_pooled": float(metrics.auc(counts)),
        "auc_mean": _mean([row.auc for row in rows]),
        "auc_images_skipped": sum(math.isnan(row.auc) for row in rows),
        "maxf": float(best),
        "maxf_threshold": float(where),
        "ap": float(metrics.average_precision(counts)),
        "threshold": threshold,
        **_decision_figures(chosen),
        "iou_mask": float(metrics.iou(tally.mask[group])),
        "ms_per_image": tally.milliseconds(group),
    }
    if group in tally.layout:
        figures["layout"] = _layout_figures(tally.layout[group], tally.labels.get(group))
    return figures


def _decision_figures(chosen: Decisions | None) -> dict[str, float]:
    formulas: dict[str, Callable[[Decisions], Tensor]] = {
        "iou": metrics.iou,
        "f": metrics.f_measure,
        "precision": metrics.precision,
        "recall": metrics.recall,
    }
    return {
        key: math.nan if chosen is None else float(formula(chosen))
        for key, formula in formulas.items()
    }


def _mean(values: Sequence[float]) -> float:
    """The mean of the defined values; NaN when there is none."""
    defined = [value for value in values if not math.isnan(value)]
    return sum(defined) / len(defined) if defined else math.nan


# --- layout -----------------------------------------------------------------------------


def _layout_figures(confusion: Tensor, labels: Tensor | None) -> dict[str, Any]:
    """Recalls under both readings of void; over labelled pixels too where labels abstain."""
    figures: dict[str, Any] = _recalls(confusion)
    figures["void_as_vertical"] = _recalls(metrics.void_as_vertical(confusion))
    if labels is not None:
        figures["labelled_share"] = float(metrics.labelled_share(labels))
        figures["labelled"] = _recalls(labels)
        figures["labelled"]["void_as_vertical"] = _recalls(metrics.void_as_vertical(labels))
    return figures


def _recalls(confusion: Tensor) -> dict[str, Any]:
    values = metrics.class_recalls(confusion).tolist()
    named: dict[str, Any] = dict(zip(metrics.LAYOUT_CLASSES, values, strict=True))
    return {**named, "mean": _mean(values)}


def _layout_means(layout: Mapping[str, Tensor], labels: Mapping[str, Tensor]) -> dict[str, Any]:
    return _mean_tree([_layout_figures(layout[group], labels.get(group)) for group in layout])


def _mean_tree(trees: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The means of equally built trees of figures, leaf by leaf."""
    return {
        key: _mean_tree([tree[key] for tree in trees])
        if isinstance(value, Mapping)
        else _mean([tree[key] for tree in trees])
        for key, value in trees[0].items()
    }


# --- single pictures --------------------------------------------------------------------


def image_f(row: ImageRow, threshold: float) -> float:
    """F of one picture at a threshold, of its 8-bit map; NaN without road or threshold."""
    if math.isnan(threshold) or row.road.road.sum() == 0:
        return math.nan
    return float(metrics.f_measure(metrics.decisions_at(row.road, threshold)))


def ranked(rows: Sequence[ImageRow], thresholds: Mapping[str, float]) -> list[tuple[float, str]]:
    """(F, name) of the pictures with road at their drive's threshold, best first."""
    scored = [(image_f(row, thresholds[row.group]), row.name) for row in rows]
    return sorted((pair for pair in scored if not math.isnan(pair[0])), key=lambda p: (-p[0], p[1]))


def middle(length: int, count: int) -> slice:
    """The ``count`` places in the middle of ``length``."""
    begin = max((length - count) // 2, 0)
    return slice(begin, begin + count)


def _extremes(
    rows: Sequence[ImageRow], thresholds: Mapping[str, float], count: int = 10
) -> dict[str, Any]:
    order = ranked(rows, thresholds)
    chosen = {"best": order[:count], "median": order[middle(len(order), count)]}
    chosen["worst"] = order[::-1][:count]
    return {
        "quantiles": _quantiles([value for value, _ in order]),
        **{
            key: [{"image": name, "f": value} for value, name in part]
            for key, part in chosen.items()
        },
    }


def _quantiles(values: Sequence[float]) -> dict[str, float]:
    if not values:
        return {}
    shares = [0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0]
    found = torch.tensor(values, dtype=torch.float64).quantile(
        torch.tensor(shares, dtype=torch.float64)
    )
    return {f"{share:g}": float(value) for share, value in zip(shares, found, strict=True)}


# --- intervals --------------------------------------------------------------------------


def intervals(
    rows: Sequence[ImageRow], thresholds: Mapping[str, float], figures: Mapping[str, Any]
) -> dict[str, list[float]]:
    """95 % bootstrap intervals of the headline figures over pictures inside their drives.

    Counted on 8-bit maps, then moved by what rounding to 8 bits does to the figure itself.
    Thresholds stay as they were chosen.
    """
    groups = [[row for row in rows if row.group == group] for group in thresholds]
    counts = [_stack([row.road for row in group]) for group in groups]
    formulas = _figure_formulas(groups, counts, list(thresholds.values()))
    found = {}
    for key, formula in formulas.items():
        generator = torch.Generator().manual_seed(SEED)
        sizes = [len(group) for group in groups]
        low, high = metrics.bootstrap_interval(sizes, formula, generator, REPLICATES)
        once = [torch.ones((1, size), dtype=torch.int64) for size in sizes]
        shift = figures[key] - float(formula(once))
        found[key] = [max(low + shift, 0.0), min(high + shift, 1.0)]
    return found


def _stack(counts: Sequence[RoadCounts]) -> RoadCounts:
    return RoadCounts(
        torch.stack([one.road for one in counts]), torch.stack([one.other for one in counts])
    )


def _figure_formulas(
    groups: Sequence[Sequence[ImageRow]], counts: Sequence[RoadCounts], thresholds: Sequence[float]
) -> dict[str, Callable[[list[Tensor]], Tensor]]:
    """Each headline figure as a function of weights (replicates,images), one tensor a drive."""
    areas = [torch.tensor([row.auc for row in group], dtype=torch.float64) for group in groups]

    def over_drives(formula: Callable[[int, Tensor], Tensor]) -> Callable[[list[Tensor]], Tensor]:
        def figure(weights: list[Tensor]) -> Tensor:
            return torch.stack([formula(i, w) for i, w in enumerate(weights)]).nanmean(0)

        return figure

    def overlap(index: int, weights: Tensor) -> Tensor:
        if math.isnan(thresholds[index]):
            return torch.full((len(weights),), math.nan, dtype=torch.float64)
        return metrics.iou(
            metrics.decisions_at(metrics.pool(counts[index], weights), thresholds[index])
        )

    def mean_area(index: int, weights: Tensor) -> Tensor:
        known = ~areas[index].isnan()
        weights = weights[:, known].to(torch.float64)
        return (weights @ areas[index][known]) / weights.sum(1)

    return {
        "maxf": over_drives(lambda i, w: metrics.max_f(metrics.pool(counts[i], w))[0]),
        "auc_pooled": over_drives(lambda i, w: metrics.auc(metrics.pool(counts[i], w))),
        "auc_mean": over_drives(mean_area),
        "iou": over_drives(overlap),
    }
