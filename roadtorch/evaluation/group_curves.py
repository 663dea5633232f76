"""The curves of a run as lists of numbers: by group, and their mean over the groups."""

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import torch
from torch import Tensor

from roadtorch.evaluation import calibration, curves
from roadtorch.evaluation.curves import Curve
from roadtorch.evaluation.measure import Trusted
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.tally import WHOLE, Tally, trusted, vertical_roc
from roadtorch.evaluation.trust import ideal_risk_coverage, risk_coverage

STEPS = 200  # of FPR and of recall, in the mean over groups
MAX_POINTS = 400  # points of a curve
DIGITS = 6

Curves = Mapping[str, Sequence[Sequence[float]] | None]
"""Lists of coordinates by kind of curve; None where a curve is not defined.

``roc`` (FPR, TPR) and ``pr`` (recall, precision) of pooled counts, ``reliability`` (predicted,
observed, share of pixels); of groups also P3's averages over pictures, ``roc_vertical`` and
``roc_threshold``; of all pictures, where the detector has trust, ``risk`` and
``risk_ideal`` (coverage, mean 1 - F).
"""


class DetectorCurves(TypedDict):
    """The curves of one detector, as curves.json has them."""

    mean: Curves
    groups: Mapping[str, Curves]


RunCurves = Mapping[str, DetectorCurves]
"""By detector."""


def group_curves(tally: Tally, counting: Sequence[str]) -> DetectorCurves:
    """Curves of one detector: ``mean`` over the groups that count, and ``groups`` by group."""
    groups = {group: _curves_of(tally, group) for group in counting}
    risk = risk_curves(trusted(tally.kept(counting)))
    if list(groups) == [WHOLE]:
        return {"mean": {**groups[WHOLE], **risk}, "groups": {}}
    counts = [tally.road[group] for group in counting]
    bins = torch.tensor([one["reliability"] for one in groups.values()], dtype=torch.float64)
    mean: Curves = {
        "roc": _lists(mean_roc(counts)),
        "pr": _lists(mean_precision(counts)),
        "reliability": _rounded(bins.nanmean(0)),
        **risk,
    }
    return {"mean": mean, "groups": groups}


def _curves_of(tally: Tally, group: str) -> Curves:
    counts, vertical = tally.road[group], vertical_roc(tally, [group])
    bins = calibration.reliability(counts)
    return {
        "roc": _thinned(curves.roc(counts)),
        "pr": _thinned(curves.precision_recall(counts)),
        "reliability": [_rounded(each) for each in (bins.predicted, bins.observed, bins.share)],
        "roc_vertical": None if vertical is None else _lists(vertical),
        "roc_threshold": _thinned(curves.threshold_average(tally.kept([group]).road)),
    }


def risk_curves(pictures: Trusted | None) -> Curves:
    """Risk over coverage as trust orders the pictures, and the ideal one; empty without trust."""
    if pictures is None:
        return {}
    return {
        "risk": _thinned(risk_coverage(pictures.trust, pictures.f)),
        "risk_ideal": _thinned(ideal_risk_coverage(pictures.f)),
    }


def mean_roc(groups: Sequence[RoadCounts]) -> Curve:
    """Vertical average of the groups' pooled curves: each group weighs the same."""
    rates = torch.stack([curves.vertical_sample(counts, STEPS) for counts in groups])
    return curves.vertical_average(rates.nanmean(0))


def mean_precision(groups: Sequence[RoadCounts]) -> Curve:
    """Mean over groups of the best precision at a recall or above (as in KITTI's AP)."""
    recalls = torch.linspace(0, 1, STEPS + 1, dtype=torch.float64)
    best = torch.stack([_precision_at(curves.precision_recall(one), recalls) for one in groups])
    return Curve(recalls, best.nanmean(0))


def _precision_at(curve: Curve, recalls: Tensor) -> Tensor:
    """The best precision of a curve at each recall or above; NaN without road."""
    best = curve.y.flip(0).cummax(0).values.flip(0)
    return best[torch.searchsorted(curve.x, recalls).clamp(max=len(best) - 1)].where(
        ~curve.x[-1].isnan(), torch.nan
    )


def _thinned(curve: Curve) -> list[list[float]]:
    return _lists(curves.thin(curve, MAX_POINTS))


def _lists(curve: Curve) -> list[list[float]]:
    return [_rounded(curve.x), _rounded(curve.y)]


def _rounded(values: Tensor) -> Any:
    return values.to(torch.float64).mul(10**DIGITS).round().div(10**DIGITS).tolist()
