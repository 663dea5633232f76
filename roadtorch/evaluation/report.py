"""What a run leaves behind: the table on screen, metrics.json, per-image rows."""

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from roadtorch.errors import ConfigError, InputError
from roadtorch.evaluation import metrics
from roadtorch.evaluation.datasets import Dataset
from roadtorch.evaluation.runner import Result, Tally
from roadtorch.evaluation.summary import image_f
from roadtorch.image import write_text

IMAGE_COLUMNS = (
    *("image", "group", "detector", "auc", "maxf", "threshold"),
    *("f", "f_mask", "iou_mask", "ms", "status"),
)


# --- table ------------------------------------------------------------------------------


def score_table(detectors: Mapping[str, Mapping[str, Any]]) -> str:
    """Detector by (MaxF by drive and mean, AUC pooled and per image, IoU, ms), best MaxF first."""
    groups = _group_names(detectors)
    by_drive = [f"MaxF {group}" for group in groups]
    header = ["detector", *by_drive, "MaxF", "95 %", "AUC pooled", "AUC mean", "IoU", "ms/image"]
    order = sorted(detectors.items(), key=lambda pair: -_number(pair[1]["maxf"]))
    rows = [
        [
            name,
            *(_share(figures["groups"][group]["maxf"]) for group in groups),
            _share(figures["maxf"]),
            "–".join(_share(bound) for bound in figures["ci95"]["maxf"]),
            *(_share(figures[key]) for key in ("auc_pooled", "auc_mean", "iou")),
            f"{figures['ms_per_image']:.1f}",
        ]
        for name, figures in order
    ]
    return align([header, *rows])


def layout_table(detectors: Mapping[str, Mapping[str, Any]]) -> str:
    """Class recalls of the detectors that label the layout, by drive; empty if none does."""
    groups = _group_names(detectors)
    header = ["layout", "drive", *metrics.LAYOUT_CLASSES, "mean"]
    header += ["mean, void vertical", "mean, labelled", "labelled share"]
    rows = []
    for name, figures in detectors.items():
        if "layout" in figures:
            parts = [(group, figures["groups"][group]["layout"]) for group in groups]
            rows += [_layout_row(name, *part) for part in (*parts, ("mean", figures["layout"]))]
    return align([header, *rows]) if rows else ""


def _layout_row(name: str, group: str, figures: Mapping[str, Any]) -> list[str]:
    return [
        name,
        group,
        *(_share(figures[key]) for key in (*metrics.LAYOUT_CLASSES, "mean")),
        _share(figures["void_as_vertical"]["mean"]),
        _share(figures["labelled"]["mean"]) if "labelled" in figures else "-",
        _share(figures["labelled_share"]) if "labelled" in figures else "-",
    ]


def _group_names(detectors: Mapping[str, Mapping[str, Any]]) -> list[str]:
    first = next(iter(detectors.values()))
    return sorted(first.get("groups", {}))


def align(rows: Sequence[Sequence[str]]) -> str:
    """Rows of text in columns: the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        first, *rest = (
            cell.rjust(width) if index else cell.ljust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        lines.append("  ".join([first, *rest]).rstrip())
    return "\n".join(lines)


def _share(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3f}"


def _number(value: float) -> float:
    return -1.0 if math.isnan(value) else value


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
        "levels": metrics.LEVELS,
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
    tallies: Mapping[str, Tally],
    thresholds: Mapping[str, Mapping[str, float]],
    failures: Sequence[Result],
) -> str:
    """CSV text: a row for each picture and detector, then one for each picture that failed."""
    text = io.StringIO()
    writer = csv.DictWriter(text, IMAGE_COLUMNS, lineterminator="\n")
    writer.writeheader()
    for name, tally in tallies.items():
        for row in tally.rows:
            threshold = thresholds[name][row.group]
            values = {
                "auc": row.auc,
                "maxf": row.max_f,
                "threshold": threshold,
                "f": image_f(row, threshold),
                "f_mask": float(metrics.f_measure(row.mask)),
                "iou_mask": float(metrics.iou(row.mask)),
            }
            cells = {key: "" if math.isnan(v) else f"{v:.6f}" for key, v in values.items()}
            cells |= {"image": row.name, "group": row.group, "detector": name}
            writer.writerow({**cells, "ms": f"{1000 * row.seconds:.2f}", "status": "ok"})
    for result in failures:
        cells = {"image": result.item.name, "group": result.item.group or ""}
        writer.writerow({**cells, "status": result.failure})
    return text.getvalue()


def thresholds_of(figures: Mapping[str, Any], whole: str) -> dict[str, float]:
    """The threshold of every drive; of ``whole`` for a set without drives."""
    if "groups" not in figures:
        return {whole: figures["threshold"]}
    return {group: part["threshold"] for group, part in figures["groups"].items()}
