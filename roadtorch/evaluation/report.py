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
from roadtorch.evaluation.runner import Result
from roadtorch.evaluation.summary import image_f, thresholds_of
from roadtorch.evaluation.tally import Tally
from roadtorch.image import write_text

IMAGE_COLUMNS = (
    *("image", "group", "detector", "auc", "maxf", "threshold"),
    *("f", "f_mask", "iou_mask", "ms", "status"),
)


# --- table ------------------------------------------------------------------------------


MOST_SHOWN = 40
"""Detectors on the screen, besides the floors; a grid of 310 fills no screen well."""


def screen(document: Mapping[str, Any]) -> str:
    """The tables of a run: road, layout if somebody labels it, and detectors in pairs."""
    detectors, paired = shortlist(document["detectors"]), document["paired"]
    shown = {name: changes for name, changes in paired["detectors"].items() if name in detectors}
    tables = [score_table(detectors), layout_table(detectors)]
    tables.append(paired_table({**paired, "detectors": shown}))
    if more := len(document["detectors"]) - len(detectors):
        tables.append(f"{more} more detectors, with lower MaxF, are in metrics.json (--out DIR)")
    return "\n\n".join(filter(None, tables))


def shortlist(detectors: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """The floors and the best of the others by MaxF, in the order in which they stand."""
    order = sorted(detectors, key=lambda name: -_number(detectors[name]["maxf"]))
    best = [name for name in order if not name.startswith("prior:")][:MOST_SHOWN]
    chosen = {name for name in detectors if name.startswith("prior:")} | set(best)
    return {name: figures for name, figures in detectors.items() if name in chosen}


SCORES = {
    "AUC": "auc_pooled",
    "AUC/image": "auc_mean",
    "AP": "ap",
    "IoU": "iou",
    "EER": "eer",
    "Brier": "brier",
}
"""Columns of the table and their figures."""


def score_table(detectors: Mapping[str, Mapping[str, Any]]) -> str:
    """Detector by MaxF (by drive and mean) and the other headline figures, best MaxF first."""
    groups = _group_names(detectors)
    by_drive = [f"MaxF {group}" for group in groups]
    pooled = ["pooled"] if groups else []
    header = ["detector", *by_drive, "MaxF", "95 %", *pooled, *SCORES, "ms/image"]
    order = sorted(detectors.items(), key=lambda pair: -_number(pair[1]["maxf"]))
    rows = [
        [
            name,
            *(_share(figures["groups"][group]["maxf"]) for group in groups),
            _share(figures["maxf"]),
            _range(figures["ci95"]["maxf"]),
            *(_share(figures[part]["maxf"]) for part in pooled),
            *(_share(figures[key]) for key in SCORES.values()),
            f"{figures['ms_per_image']:.1f}",
        ]
        for name, figures in order
    ]
    return align([header, *rows])


COMPARED = {"MaxF": "maxf", "AUC": "auc_pooled", "IoU": "iou"}


def paired_table(paired: Mapping[str, Any]) -> str:
    """Each detector less the one it is compared with, with 95 % intervals; empty for one."""
    header = [f"less {paired['against']}"]
    header += [text for name in COMPARED for text in (name, "95 %")]
    rows = [
        [name, *(text for key in COMPARED.values() for text in _change(changes[key]))]
        for name, changes in paired["detectors"].items()
    ]
    return align([header, *rows]) if rows else ""


def _change(change: Mapping[str, Any]) -> tuple[str, str]:
    value, (low, high) = change["difference"], change["ci95"]
    signed = ["-" if math.isnan(part) else f"{part:+.3f}" for part in (value, low, high)]
    return signed[0], f"{signed[1]} to {signed[2]}"


def _range(bounds: Sequence[float]) -> str:
    return "–".join(_share(bound) for bound in bounds)


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
