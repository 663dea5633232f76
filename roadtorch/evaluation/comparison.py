"""How sure the figures are: pictures drawn anew, intervals, and detectors compared in pairs.

All detectors of a run are scored on the same pictures, and all are resampled with the same
draws, so that a difference between two is not blurred by what pictures they had.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from roadtorch.errors import unknown_name
from roadtorch.evaluation import calibration, curves, metrics, uncertainty
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.tally import ImageRow
from roadtorch.evaluation.uncertainty import Replicated, group_weights, replicate

SEED = 11  # of the draws
REPLICATES = 1000
PAIRED = ("maxf", "auc_pooled", "auc_mean", "ap", "iou", "brier", "layout_mean")

Formula = Callable[[Tensor], Tensor]
"""A figure of one drive from weights (draws,images) of its pictures: (draws,)."""


def resample(
    rows: Sequence[ImageRow], thresholds: Mapping[str, float], figures: Mapping[str, Any]
) -> dict[str, Replicated]:
    """Draw pictures inside their drives anew, and take every headline figure of each draw.

    thresholds: by drive, which stay as they were chosen. figures: the headline figures of all
    pictures; the draws, which are counted on 8-bit maps, are moved by what that changes.
    """
    drives = [[row for row in rows if row.group == group] for group in thresholds]
    generator = torch.Generator().manual_seed(SEED)
    weights = group_weights([len(drive) for drive in drives], generator, REPLICATES)
    formulas = [
        drive_formulas(drive, threshold)
        for drive, threshold in zip(drives, thresholds.values(), strict=True)
    ]
    found = {}
    for key in formulas[0]:
        coarse = replicate(partial(_mean_of_drives, [one[key] for one in formulas]), weights)
        value = headline(figures, key)
        found[key] = Replicated(value, coarse.draws + (value - coarse.value))
    return found


def _mean_of_drives(formulas: Sequence[Formula], weights: Sequence[Tensor]) -> Tensor:
    values = [formula(weight) for formula, weight in zip(formulas, weights, strict=True)]
    return torch.stack(values).nanmean(0)


def headline(figures: Mapping[str, Any], key: str) -> float:
    """A headline figure by its name here; the layout's mean recall is ``layout_mean``."""
    return figures["layout"]["mean"] if key == "layout_mean" else figures[key]


def drive_formulas(rows: Sequence[ImageRow], threshold: float) -> dict[str, Formula]:
    """The headline figures of one drive as functions of its pictures' weights."""
    counts = RoadCounts(
        torch.stack([row.road.road for row in rows]), torch.stack([row.road.other for row in rows])
    )

    def of_counts(figure: Callable[[RoadCounts], Tensor]) -> Formula:
        return lambda weights: figure(metrics.pool(counts, weights))

    def at_threshold(figure: Callable[[metrics.Decisions], Tensor]) -> Formula:
        if math.isnan(threshold):
            return lambda weights: torch.full((len(weights),), math.nan, dtype=torch.float64)
        return of_counts(lambda pooled: figure(metrics.decisions_at(pooled, threshold)))

    formulas = {
        "maxf": of_counts(lambda pooled: metrics.max_f(pooled)[0]),
        "auc_pooled": of_counts(metrics.auc),
        "auc_mean": _mean_formula(torch.tensor([row.auc for row in rows], dtype=torch.float64)),
        "ap": of_counts(metrics.average_precision),
        "eer": of_counts(lambda pooled: curves.equal_error_rate(curves.operating_points(pooled))),
        "brier": of_counts(calibration.brier),
        "iou": at_threshold(metrics.iou),
        "f": at_threshold(metrics.f_measure),
    }
    if rows[0].layout is not None:
        confusions = torch.stack([row.layout for row in rows if row.layout is not None])
        formulas["layout_mean"] = _layout_formula(confusions)
    return formulas


def _mean_formula(values: Tensor) -> Formula:
    known = ~values.isnan()

    def mean(weights: Tensor) -> Tensor:
        weights = weights[:, known].to(torch.float64)
        return (weights @ values[known]) / weights.sum(1)

    return mean


def _layout_formula(confusions: Tensor) -> Formula:
    def mean_recall(weights: Tensor) -> Tensor:
        flat = weights.to(torch.float64) @ confusions.flatten(1).to(torch.float64)
        return metrics.mean_class_recall(flat.reshape(-1, *confusions.shape[1:]))

    return mean_recall


# --- intervals and pairs ----------------------------------------------------------------


def intervals(resampled: Mapping[str, Replicated]) -> dict[str, list[float]]:
    """95 % intervals of the headline figures, inside [0,1]."""
    found = {key: uncertainty.interval(figure) for key, figure in resampled.items()}
    return {key: [max(low, 0.0), min(high, 1.0)] for key, (low, high) in found.items()}


def check_against(names: Sequence[str], against: str | None) -> None:
    """ConfigError when the detector that the others are to be compared with is not in the run."""
    if against is not None and against not in names:
        raise unknown_name("detector of this run", against, names)


def best_of(figures: Mapping[str, Mapping[str, Any]]) -> str:
    """The detector with the highest MaxF, the first of equals."""
    known = {name: one["maxf"] for name, one in figures.items() if not math.isnan(one["maxf"])}
    return max(known, key=lambda name: known[name], default=next(iter(figures)))


def paired(resampled: Mapping[str, Mapping[str, Replicated]], against: str) -> dict[str, Any]:
    """Every detector less the one called ``against``: differences with 95 % intervals."""
    other = resampled[against]
    found = {
        name: {
            key: uncertainty.difference(one[key], other[key])
            for key in PAIRED
            if key in one and key in other
        }
        for name, one in resampled.items()
        if name != against
    }
    return {
        "against": against,
        "detectors": {
            name: {
                key: {"difference": change.value, "ci95": list(uncertainty.interval(change))}
                for key, change in changes.items()
            }
            for name, changes in found.items()
        },
    }
