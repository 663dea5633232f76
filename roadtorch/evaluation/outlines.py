"""The curves of a run as numbers for a file: by drive, and their mean over the drives."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from roadtorch.evaluation import calibration, curves
from roadtorch.evaluation.curves import Curve
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.summary import drive, vertical_curve
from roadtorch.evaluation.tally import WHOLE, Tally

STEPS = 200  # of FPR and of recall, in the mean over drives
MOST = 400  # points of a curve
DIGITS = 6


def outlines(tally: Tally) -> dict[str, Any]:
    """Curves of one detector: ``mean`` over the drives, and ``groups`` by drive.

    Each has ``roc`` (FPR, TPR) and ``pr`` (recall, precision) of the pooled counts,
    ``reliability`` (predicted, observed, share of pixels), and P3's averages over pictures
    ``roc_vertical`` and ``roc_threshold``; all as lists of coordinates.
    """
    groups = {group: _drive_curves(tally, group) for group in tally.road}
    if list(groups) == [WHOLE]:
        return {"mean": groups[WHOLE], "groups": {}}
    mean = {
        "roc": _lists(mean_roc(list(tally.road.values()))),
        "pr": _lists(mean_precision(list(tally.road.values()))),
        "reliability": _mean_reliability([group["reliability"] for group in groups.values()]),
    }
    return {"mean": mean, "groups": groups}


def _drive_curves(tally: Tally, group: str) -> dict[str, Any]:
    counts = tally.road[group]
    part = drive(tally, group, math.nan)
    vertical = vertical_curve(part)
    images = RoadCounts(
        torch.stack([row.road.road for row in part.rows]),
        torch.stack([row.road.other for row in part.rows]),
    )
    return {
        "roc": _lists(curves.thin(curves.roc(counts), MOST)),
        "pr": _lists(curves.thin(curves.precision_recall(counts), MOST)),
        "reliability": _reliability(counts),
        "roc_vertical": None if vertical is None else _lists(vertical),
        "roc_threshold": _lists(curves.thin(curves.threshold_average(images), MOST)),
    }


def mean_roc(drives: Sequence[RoadCounts]) -> Curve:
    """Vertical average of the drives' pooled curves: each drive weighs the same."""
    rates = torch.stack([curves.vertical_sample(counts, STEPS) for counts in drives])
    return curves.vertical_average(rates.nanmean(0))


def mean_precision(drives: Sequence[RoadCounts]) -> Curve:
    """Mean over drives of the best precision at a recall or above (as in KITTI's AP)."""
    recalls = torch.linspace(0, 1, STEPS + 1, dtype=torch.float64)
    found = torch.stack([_precision_at(curves.precision_recall(one), recalls) for one in drives])
    return Curve(recalls, found.nanmean(0))


def _precision_at(curve: Curve, recalls: Tensor) -> Tensor:
    """The best precision of a curve at each recall or above; NaN without road."""
    best = curve.y.flip(0).cummax(0).values.flip(0)
    return best[torch.searchsorted(curve.x, recalls).clamp(max=len(best) - 1)].where(
        ~curve.x[-1].isnan(), torch.nan
    )


def _reliability(counts: RoadCounts) -> list[list[float]]:
    found = calibration.reliability(counts)
    return [_rounded(values) for values in (found.predicted, found.observed, found.share)]


def _mean_reliability(drives: Sequence[Sequence[Sequence[float]]]) -> list[list[float]]:
    return _rounded(torch.tensor(drives, dtype=torch.float64).nanmean(0))


def _lists(curve: Curve) -> list[list[float]]:
    return [_rounded(curve.x), _rounded(curve.y)]


def _rounded(values: Tensor) -> Any:
    return values.to(torch.float64).mul(10**DIGITS).round().div(10**DIGITS).tolist()
