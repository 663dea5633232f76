"""An evaluation as metrics.json has it, and what a later run reads back of one."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from roadtorch.errors import ConfigError, InputError
from roadtorch.evaluation.measure import Figures, Measure
from roadtorch.evaluation.methods import Method
from roadtorch.evaluation.result import DetectorFigures, Evaluation
from roadtorch.io.bounded import read_regular, reason
from roadtorch.version import __version__


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
        "failed": [{"image": one.image, "reason": one.reason} for one in evaluation.failures],
        "detectors": {
            name: _detector(one, measures) for name, one in evaluation.detectors.items()
        },
        "paired": _paired(evaluation),
    })  # fmt: skip


def _detector(one: DetectorFigures, measures: Sequence[Measure]) -> dict[str, Any]:
    by_f = one.pictures_by_f
    content = {
        **_levels(one.headline),
        "maxf_threshold": one.best_threshold,
        "threshold_from": one.threshold_from,
        "images_by_f": {
            "quantiles": {f"{share:g}": value for share, value in by_f.quantiles.items()},
            **{
                part: [{"image": name, "f": value} for value, name in pictures]
                for part, pictures in (
                    ("best", by_f.best), ("median", by_f.median), ("worst", by_f.worst)
                )
            },
        },
    }  # fmt: skip
    if one.groups:
        content["groups"] = {group: _levels(figures) for group, figures in one.groups.items()}
        content["left_out"] = {group: _levels(figures) for group, figures in one.left_out.items()}
        content["pooled"] = _levels(one.pooled)
    if one.conditions:
        content["conditions"] = {name: _levels(part) for name, part in one.conditions.items()}
    content["ci95"] = {
        measure.flat_key: one.intervals[measure.key]
        for measure in measures
        if measure.key in one.intervals
    }
    return {
        **content,
        "threshold_default": one.method.threshold,
        "settings": one.method.settings,
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


def _paired(evaluation: Evaluation) -> dict[str, Any]:
    flat = {measure.key: measure.flat_key for measure in evaluation.measures}
    return {
        "against": evaluation.comparison.against,
        "detectors": {
            name: {
                flat[key]: {"difference": change.value, "ci95": change.interval}
                for key, change in changes.items()
            }
            for name, changes in evaluation.comparison.differences.items()
        },
    }


def defined(value: Any) -> Any:
    """The same with None for every NaN, as JSON wants it."""
    if isinstance(value, Mapping):
        return {key: defined(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [defined(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value


# --- thresholds of an earlier run -------------------------------------------------------


def earlier_thresholds(path: Path, methods: Sequence[Method]) -> dict[str, float]:
    """For every method the threshold that an earlier run chose on all its groups.

    path: its metrics.json. Raises InputError for another file; ConfigError when the run has
    no such detector, or it had other settings: a threshold means nothing for another detector.
    """
    earlier = _read_thresholds(path)
    return {one.name: _threshold_for(one, path, earlier) for one in methods}


def _read_thresholds(path: Path) -> dict[str, tuple[float, Mapping[str, Any]]]:
    """Detector → (threshold, settings)."""
    try:
        detectors = json.loads(read_regular(path).decode())["detectors"]
        return {
            name: (_share(figures["maxf_threshold"]), dict(figures.get("settings", {})))
            for name, figures in detectors.items()
            if figures["maxf_threshold"] is not None
        }
    except (OSError, UnicodeDecodeError) as problem:
        what = f"cannot be read: {reason(problem)}"
        raise InputError(path, what, "give a metrics.json") from None
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        raise InputError(path, "is not a metrics.json", "give one that evaluate wrote") from None


def _share(value: Any) -> float:
    """A number in [0,1]; ValueError or TypeError for anything else, NaN among it."""
    if not 0 <= float(value) <= 1:
        raise ValueError("not in [0,1]")
    return float(value)


def _threshold_for(
    method: Method, path: Path, earlier: Mapping[str, tuple[float, Mapping[str, Any]]]
) -> float:
    name = method.name
    if name not in earlier:
        remedy = f"it has {', '.join(sorted(earlier))}"
        raise ConfigError(path, f"has no threshold for {name}", remedy)
    threshold, settings = earlier[name]
    if settings != method.settings:
        what = f"chose the threshold of {name} with other settings"
        raise ConfigError(path, what, "run both with the same --set")
    return threshold
