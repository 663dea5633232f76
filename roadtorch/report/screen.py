"""The tables of a run on the screen."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from roadtorch.evaluation import metrics

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
