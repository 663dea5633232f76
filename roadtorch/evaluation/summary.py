"""From counts to figures: by drive, their means, and thresholds chosen on other drives."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

import torch
from torch import Tensor

from roadtorch.evaluation import boundary, calibration, curves, metrics
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.evaluation.tally import WHOLE, ImageRow, Tally

AVERAGED = (
    *("auc_pooled", "auc_mean", "eer", "auc_vertical", "eer_vertical"),
    *("maxf", "ap", "iou", "f", "precision", "recall"),
    *("iou_mask", "f_mask", "precision_mask", "recall_mask", "brier", "ece"),
)
"""The figures whose headline is the mean over the drives."""

DECIDED: Mapping[str, Callable[[Decisions], Tensor]] = {
    "iou": metrics.iou,
    "f": metrics.f_measure,
    "precision": metrics.precision,
    "recall": metrics.recall,
}


# --- thresholds -------------------------------------------------------------------------


def shared_threshold(groups: Mapping[str, RoadCounts]) -> float:
    """The threshold with the highest F, averaged over drives; the lowest of equals.

    NaN when no drive has road.
    """
    found = [metrics.f_curve(counts) for counts in groups.values() if counts.road.sum() > 0]
    return float(metrics.best_threshold(torch.stack(found).mean(0))[1]) if found else math.nan


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


# --- parts of a set ---------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """The counts of one drive, or of the whole set at once.

    chosen: the outcome at the threshold of each drive; None where there is none.
    """

    road: RoadCounts
    mask: Decisions
    boundary: Tensor
    curve: Tensor | None  # sum of the single pictures' ROC curves
    layout: Tensor | None
    labels: Tensor | None
    chosen: Decisions | None
    rows: Sequence[ImageRow]
    milliseconds: float


def drive(tally: Tally, group: str, threshold: float) -> Part:
    """One drive."""
    return Part(
        tally.road[group],
        tally.mask[group],
        tally.boundary[group],
        tally.curve.get(group),
        tally.layout.get(group),
        tally.labels.get(group),
        None if math.isnan(threshold) else metrics.decisions_at(tally.road[group], threshold),
        [row for row in tally.rows if row.group == group],
        tally.milliseconds(group),
    )


def together(parts: Sequence[Part], milliseconds: float) -> Part:
    """Several drives as one: their counts added up."""

    def total(values: Sequence[Any]) -> Any:
        known = [value for value in values if value is not None]
        return reduce(add, known) if known else None

    sums = [total([getattr(part, name) for part in parts]) for name in _SUMMED]
    return Part(*sums, rows=[row for part in parts for row in part.rows], milliseconds=milliseconds)


_SUMMED = ("road", "mask", "boundary", "curve", "layout", "labels", "chosen")


# --- figures ----------------------------------------------------------------------------


def summarise(tally: Tally, default: float, given: float | None = None) -> dict[str, Any]:
    """All figures of one detector, as metrics.json has them.

    default: the detector's own threshold. given: a threshold chosen elsewhere.
    """
    source, thresholds = choose_thresholds(tally.road, default, given)
    parts = {group: drive(tally, group, thresholds[group]) for group in tally.road}
    groups = {
        group: {**part_figures(part), "threshold": thresholds[group]}
        for group, part in parts.items()
    }
    whole = part_figures(together(list(parts.values()), tally.milliseconds()))
    figures: dict[str, Any] = {
        key: _mean([group[key] for group in groups.values()]) for key in AVERAGED
    }
    figures["boundary_f"] = _mean_tree([group["boundary_f"] for group in groups.values()])
    figures["maxf_threshold"] = shared_threshold(tally.road)
    figures["threshold_from"] = source
    figures["images"] = whole["images"]
    figures["auc_images_skipped"] = whole["auc_images_skipped"]
    figures["ms_per_image"] = tally.milliseconds()
    figures["images_by_f"] = _extremes(tally.rows, thresholds)
    if tally.layout:
        figures["layout"] = _mean_tree([group["layout"] for group in groups.values()])
    if list(groups) == [WHOLE]:
        return {**groups[WHOLE], **figures}
    return {**figures, "groups": groups, "pooled": whole}


def part_figures(part: Part) -> dict[str, Any]:
    """The figures of a drive, or of a whole set whose counts are pooled."""
    best, where = metrics.max_f(part.road)
    figures: dict[str, Any] = {
        "images": len(part.rows),
        "auc_pooled": float(metrics.auc(part.road)),
        "eer": float(curves.equal_error_rate(curves.operating_points(part.road))),
        **_image_figures(part),
        "maxf": float(best),
        "maxf_threshold": float(where),
        "working_point": _numbers(metrics.working_point(part.road)),
        "ap": float(metrics.average_precision(part.road)),
        **{key: _decided(formula, part.chosen) for key, formula in DECIDED.items()},
        **{f"{key}_mask": _decided(formula, part.mask) for key, formula in DECIDED.items()},
        "boundary_f": boundary.boundary_figures(part.boundary),
        "brier": float(calibration.brier(part.road)),
        "ece": float(calibration.expected_error(part.road)),
        "ms_per_image": part.milliseconds,
    }
    if part.layout is not None:
        figures["layout"] = _layout_figures(part.layout, part.labels)
    return figures


def _image_figures(part: Part) -> dict[str, float]:
    """What is averaged over single pictures: their areas, and their curves (P3)."""
    skipped = sum(math.isnan(row.auc) for row in part.rows)
    average = vertical_curve(part)
    return {
        "auc_mean": _mean([row.auc for row in part.rows]),
        "auc_images_skipped": skipped,
        "auc_vertical": math.nan if average is None else float(curves.area(average)),
        "eer_vertical": math.nan if average is None else float(curves.equal_error_rate(average)),
    }


def vertical_curve(part: Part) -> curves.Curve | None:
    """The vertical average of the pictures' ROC curves; None without a picture that has one."""
    count = sum(not math.isnan(row.auc) for row in part.rows)
    return None if part.curve is None else curves.vertical_average(part.curve / count)


def _decided(formula: Callable[[Decisions], Tensor], outcome: Decisions | None) -> float:
    return math.nan if outcome is None else float(formula(outcome))


def _numbers(figures: Mapping[str, Tensor]) -> dict[str, float]:
    return {key: float(value) for key, value in figures.items()}


def _mean(values: Sequence[float]) -> float:
    """The mean of the defined values; NaN when there is none."""
    defined = [value for value in values if not math.isnan(value)]
    return sum(defined) / len(defined) if defined else math.nan


# --- layout -----------------------------------------------------------------------------


def _layout_figures(confusion: Tensor, labels: Tensor | None) -> dict[str, Any]:
    """Recalls under both readings of void; over labelled pixels too where labels abstain."""
    figures: dict[str, Any] = _recalls(confusion)
    figures["accuracy"] = float(metrics.layout_accuracy(confusion))
    figures["confusion"] = {
        truth: dict(zip(metrics.LAYOUT_CLASSES, row, strict=True))
        for truth, row in zip(
            metrics.LAYOUT_CLASSES, metrics.normalised_confusion(confusion).tolist(), strict=True
        )
    }
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


def chosen_pictures(
    rows: Sequence[ImageRow], thresholds: Mapping[str, float], count: int
) -> dict[str, list[tuple[float, str]]]:
    """(F, name) of the best, the median and the worst ``count`` pictures."""
    order = ranked(rows, thresholds)
    return {
        "best": order[:count],
        "median": order[middle(len(order), count)],
        "worst": order[::-1][:count],
    }


def _extremes(
    rows: Sequence[ImageRow], thresholds: Mapping[str, float], count: int = 10
) -> dict[str, Any]:
    values = [value for value, _ in ranked(rows, thresholds)]
    return {
        "quantiles": _quantiles(values),
        **{
            part: [{"image": name, "f": value} for value, name in pictures]
            for part, pictures in chosen_pictures(rows, thresholds, count).items()
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


def thresholds_of(figures: Mapping[str, Any]) -> dict[str, float]:
    """The threshold of every drive in figures; of ``WHOLE`` for a set without drives."""
    if "groups" not in figures:
        return {WHOLE: figures["threshold"]}
    return {group: part["threshold"] for group, part in figures["groups"].items()}
