"""An evaluation as metrics.json and curves.json have it."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import torch
from torch import Tensor

from roadtorch.base.version import __version__
from roadtorch.evaluation import curves
from roadtorch.evaluation.curves import Curve
from roadtorch.evaluation.measure import Figures, Measure
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.result import (
    DetectorFigures,
    Evaluation,
    best_median_worst,
    pictures_by_f,
)
from roadtorch.evaluation.tally import WHOLE, Tally
from roadtorch.evaluation.trust import Trusted, risk_coverage, trusted

SHOWN = 10  # best, median and worst pictures in metrics.json

QUANTILES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)  # of F over the single pictures


def document(evaluation: Evaluation, command: str) -> dict[str, Any]:
    """The content of metrics.json: the run, then every detector's figures; None for undefined."""
    dataset, measures = evaluation.dataset, evaluation.measures
    return defined({
        "roadtorch": __version__,
        "dataset": dataset.name,
        "split": dataset.split,
        "images": evaluation.images,
        "void": "ignored",
        "command": command,
        "levels": dataset.levels,
        "view": "the picture" if dataset.view is None else dataset.view.name,
        "left_out": evaluation.left_out,
        "failed": [
            {"image": failure.image, "reason": failure.reason} for failure in evaluation.failures
        ],
        "detectors": {
            name: _detector(figures, evaluation.tallies[name], measures)
            for name, figures in evaluation.detectors.items()
        },
        "paired": {
            "against": evaluation.comparison.against,
            "detectors": {
                name: {
                    key.replace("/", "_"): {"difference": change.value, "ci95": change.interval}
                    for key, change in changes.items()
                }
                for name, changes in evaluation.comparison.differences.items()
            },
        },
    })  # fmt: skip


def _detector(one: DetectorFigures, tally: Tally, measures: Sequence[Measure]) -> dict[str, Any]:
    order = pictures_by_f(tally, one)
    values = torch.tensor([value for value, _ in order], dtype=torch.float64)
    shares = torch.tensor(QUANTILES, dtype=torch.float64)
    quantiles = values.quantile(shares).tolist() if order else []
    content = {
        **_levels(one.headline),
        "maxf_threshold": one.best_threshold,
        "threshold_from": one.threshold_from,
        "images_by_f": {
            "quantiles": {f"{share:g}": q for share, q in zip(QUANTILES, quantiles, strict=False)},
            **{
                part: [{"image": name, "f": value} for value, name in pictures]
                for part, pictures in best_median_worst(order, SHOWN).items()
            },
        },
    }
    if one.groups:
        content["groups"] = {group: _levels(figures) for group, figures in one.groups.items()}
        content["left_out"] = {group: _levels(figures) for group, figures in one.left_out.items()}
        content["pooled"] = _levels(one.pooled)
    if one.conditions:
        content["conditions"] = {name: _levels(part) for name, part in one.conditions.items()}
    content["ci95"] = {
        measure.key.replace("/", "_"): one.intervals[measure.key]
        for measure in measures
        if measure.key in one.intervals
    }
    return {
        **content,
        "threshold_default": one.contender.threshold,
        "settings": one.contender.settings,
        "baseline": one.is_baseline,
    }


def _levels(figures: Figures) -> dict[str, Any]:
    """Figures with keys like "layout/mean" as nested mappings."""
    levels: dict[str, Any] = {}
    for key, value in figures.items():
        *outer, last = key.split("/")
        branch = levels
        for name in outer:
            branch = branch.setdefault(name, {})
        branch[last] = value
    return levels


def defined(value: Any) -> Any:
    """The same with None for every NaN, as JSON wants it."""
    if isinstance(value, Mapping):
        return {key: defined(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [defined(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value


# --- curves.json --------------------------------------------------------------------------


STEPS = 200  # of FPR and of recall, in the mean over groups
MAX_POINTS = 400  # points of a curve
DIGITS = 6

Curves = Mapping[str, Sequence[Sequence[float]] | None]
"""Lists of coordinates by kind of curve; None where a curve is not defined.

``roc`` (FPR, TPR) and ``pr`` (recall, precision) of pooled counts, ``reliability`` (predicted,
observed, share of pixels); of all pictures, where the detector has trust, ``risk`` and
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
    reliabilities = [own["reliability"] for own in groups.values()]
    bins = torch.tensor(reliabilities, dtype=torch.float64)
    mean: Curves = {
        "roc": _lists(mean_roc(counts)),
        "pr": _lists(mean_precision(counts)),
        "reliability": _rounded(bins.nanmean(0)),
        **risk,
    }
    return {"mean": mean, "groups": groups}


def _curves_of(tally: Tally, group: str) -> Curves:
    counts = tally.road[group]
    bins = curves.reliability(counts)
    return {
        "roc": _thinned(curves.roc(counts)),
        "pr": _thinned(curves.precision_recall(counts)),
        "reliability": [_rounded(each) for each in (bins.predicted, bins.observed, bins.share)],
    }


def risk_curves(pictures: Trusted | None) -> Curves:
    """Risk over coverage as trust orders the pictures, and the ideal one; empty without trust."""
    if pictures is None:
        return {}
    return {
        "risk": _thinned(risk_coverage(pictures.trust, pictures.f)),
        "risk_ideal": _thinned(risk_coverage(pictures.f, pictures.f)),
    }


def mean_roc(groups: Sequence[RoadCounts]) -> Curve:
    """Vertical average of the groups' pooled curves: each group weighs the same."""
    rates = torch.stack([curves.vertical_sample(counts, STEPS) for counts in groups])
    return curves.vertical_average(rates.nanmean(0))


def mean_precision(groups: Sequence[RoadCounts]) -> Curve:
    """Mean over groups of the best precision at a recall or above (as in KITTI's AP)."""
    recalls, rows = torch.linspace(0, 1, STEPS + 1, dtype=torch.float64), []
    for curve in map(curves.precision_recall, groups):
        best = curve.y.flip(0).cummax(0).values.flip(0)
        place = torch.searchsorted(curve.x, recalls).clamp(max=len(best) - 1)
        rows.append(best[place].where(~curve.x[-1].isnan(), torch.nan))  # without road
    return Curve(recalls, torch.stack(rows).nanmean(0))


def _thinned(curve: Curve) -> list[list[float]]:
    return _lists(curves.thin(curve, MAX_POINTS))


def _lists(curve: Curve) -> list[list[float]]:
    return [_rounded(curve.x), _rounded(curve.y)]


def _rounded(values: Tensor) -> Any:
    return values.to(torch.float64).mul(10**DIGITS).round().div(10**DIGITS).tolist()
