"""What a run leaves behind in a folder: figures, rows, tables, sheets of images, the page."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, fields
from itertools import chain
from pathlib import Path
from typing import Any

from roadtorch.base.atomic import csv_text, write_json, write_text
from roadtorch.base.version import __version__
from roadtorch.evaluation.measure import Figures, Measure
from roadtorch.evaluation.report.charts import run_charts
from roadtorch.evaluation.report.montage import write_montages
from roadtorch.evaluation.report.table import page_text
from roadtorch.evaluation.report.tables import run_tables
from roadtorch.evaluation.result import (
    DetectorFigures,
    Evaluation,
    Failure,
    ImageRow,
    image_rows,
)

SHEETS = 4  # images of a sheet, if nobody says

COLUMNS = (*(each.name for each in fields(ImageRow)), "status")


def write(evaluation: Evaluation, out: Path, command: str = "", images: int = SHEETS) -> None:
    """Write everything that stays of a run; the folder has to be there.

    command: what made it, for the record. images: how many the sheets of the best, median
    and worst show; none for 0.
    """
    rows = [
        row
        for name, tally in evaluation.tallies.items()
        for row in image_rows(name, tally, evaluation.detectors[name])
    ]
    write_json(out / "metrics.json", document(evaluation, command))
    write_text(out / "images.csv", rows_csv(rows, evaluation.failures, evaluation.left_out))
    tables = run_tables(evaluation)
    write_text(out / "tables.md", "\n".join(table.markdown() for table in tables))
    sheets = write_montages(out, evaluation, images) if images else {}
    parts = (figures.headline for figures in evaluation.detectors.values())
    known = set(chain.from_iterable(parts))
    values = {
        "evaluation": evaluation,
        "tables": tables,
        "charts": run_charts(evaluation),
        "sheets": sheets,
        "measures": [one for one in evaluation.measures if one.shown and one.key in known],
    }
    write_text(out / "report.html", page_text("report.html", command, values))


def rows_csv(
    rows: Sequence[ImageRow], failures: Sequence[Failure], left_out: Collection[str] = ()
) -> str:
    """Return CSV text: a line for each image and detector, then one for each image that failed.

    left_out: groups whose images say so, since no mean counts them.
    """

    def cell(value: str | float) -> str:
        if isinstance(value, str):
            return value
        return "" if math.isnan(value) else f"{value:.6f}"

    scored = (
        {key: cell(value) for key, value in asdict(row).items()}
        | {"ms": f"{row.ms:.2f}", "status": "left out" if row.group in left_out else "ok"}
        for row in rows
    )
    failed = (
        {"image": failure.image, "group": failure.group or "", "status": failure.reason}
        for failure in failures
    )
    return csv_text(COLUMNS, chain(scored, failed))


# --- metrics.json -----------------------------------------------------------------------


def document(evaluation: Evaluation, command: str) -> dict[str, Any]:
    """Return the content of metrics.json: the run, then every detector's figures."""
    dataset, measures = evaluation.dataset, evaluation.measures
    return _defined({
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
            name: _detector(figures, measures) for name, figures in evaluation.detectors.items()
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


def _detector(one: DetectorFigures, measures: Sequence[Measure]) -> dict[str, Any]:
    content = {
        **_levels(one.headline),
        "maxf_threshold": one.best_threshold,
        "threshold_from": one.threshold_from,
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
    """Return figures with keys like "layout/mean" as nested mappings."""
    levels: dict[str, Any] = {}
    for key, value in figures.items():
        *outer, last = key.split("/")
        branch = levels
        for name in outer:
            branch = branch.setdefault(name, {})
        branch[last] = value
    return levels


def _defined(value: Any) -> Any:
    """Return the same with None for every NaN, as JSON wants it."""
    if isinstance(value, Mapping):
        return {key: _defined(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_defined(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value
