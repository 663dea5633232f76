"""What a run leaves behind: metrics.json and the rows of single pictures."""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from roadtorch.data.dataset import Dataset
from roadtorch.errors import ConfigError, InputError
from roadtorch.evaluation import metrics
from roadtorch.evaluation.runner import Result
from roadtorch.evaluation.summary import image_f, thresholds_of
from roadtorch.evaluation.tally import Tally
from roadtorch.files import write_text

IMAGE_COLUMNS = (
    *("image", "group", "detector", "auc", "maxf", "threshold"),
    *("f", "f_mask", "iou_mask", "ms", "status"),
)

# --- metrics.json -----------------------------------------------------------------------


def metrics_document(
    dataset: Dataset,
    detectors: Mapping[str, Mapping[str, Any]],
    failures: Sequence[Result],
    version: str,
    command: str,
) -> dict[str, Any]:
    """The content of metrics.json: the run, then every detector's figures."""
    return {
        "roadtorch": version,
        "dataset": dataset.name,
        "split": dataset.split,
        "images": len(dataset.items) - len(failures),
        "void": "ignored",
        "command": command,
        "levels": dataset.levels,
        "view": "the picture" if dataset.view is None else dataset.view.name,
        "failed": [{"image": r.item.name, "reason": r.failure} for r in failures],
        "detectors": detectors,
    }


def write_metrics(path: Path, document: Mapping[str, Any]) -> None:
    """Write metrics.json; figures that are not defined become null."""
    text = json.dumps(_nulls(document), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def _nulls(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _nulls(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_nulls(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def read_thresholds(path: Path) -> dict[str, tuple[float, dict[str, Any]]]:
    """Detector → (threshold chosen on all drives, settings) from an earlier metrics.json."""
    try:
        detectors = json.loads(path.read_text(encoding="utf-8"))["detectors"]
        return {
            name: (float(figures["maxf_threshold"]), dict(figures.get("settings", {})))
            for name, figures in detectors.items()
            if figures["maxf_threshold"] is not None
        }
    except (OSError, UnicodeDecodeError) as problem:
        raise InputError(path, f"cannot be read: {problem}", "give a metrics.json") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(path, "is not a metrics.json", "give one that evaluate wrote") from None


def earlier_threshold(
    path: Path,
    earlier: Mapping[str, tuple[float, dict[str, Any]]],
    name: str,
    settings: Mapping[str, Any],
) -> float:
    """The threshold of the earlier run for a detector with the same settings.

    Raises ConfigError when the run has no such detector, or it had other settings: a
    threshold means nothing for another detector.
    """
    if name not in earlier:
        remedy = f"it has {', '.join(sorted(earlier))}"
        raise ConfigError(path, f"has no threshold for {name}", remedy)
    threshold, others = earlier[name]
    if others != settings:
        what = f"chose the threshold of {name} with other settings"
        raise ConfigError(path, what, "run both with the same --set")
    return threshold


# --- per-image rows ---------------------------------------------------------------------


def image_rows(
    tallies: Mapping[str, Tally], figures: Mapping[str, Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """The figures of each picture and detector, under ``IMAGE_COLUMNS``; None for undefined."""
    rows = []
    for name, tally in tallies.items():
        thresholds = thresholds_of(figures[name])
        for row in tally.rows:
            threshold = thresholds[row.group]
            values = {
                "auc": row.auc,
                "maxf": row.max_f,
                "threshold": threshold,
                "f": image_f(row, threshold),
                "f_mask": float(metrics.f_measure(row.mask)),
                "iou_mask": float(metrics.iou(row.mask)),
            }
            known = {key: None if math.isnan(value) else value for key, value in values.items()}
            about = {"image": row.name, "group": row.group, "detector": name}
            rows.append({**about, **known, "ms": 1000 * row.seconds, "status": "ok"})
    return rows


def rows_csv(rows: Sequence[Mapping[str, Any]], failures: Sequence[Result]) -> str:
    """CSV text: a line for each picture and detector, then one for each picture that failed."""
    text = io.StringIO()
    writer = csv.DictWriter(text, IMAGE_COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        cells = {k: f"{v:.6f}" if isinstance(v, float) else v for k, v in row.items()}
        writer.writerow({**cells, "ms": f"{row['ms']:.2f}"})
    for result in failures:
        cells = {"image": result.item.name, "group": result.item.group or ""}
        writer.writerow({**cells, "status": result.failure})
    return text.getvalue()
