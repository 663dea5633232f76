"""What a run leaves behind in a folder: figures, rows, tables, sheets of images, the page."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from math import isnan
from pathlib import Path
from typing import Any

from roadtorch.base.atomic import csv_text, write_json, write_text
from roadtorch.base.version import __version__
from roadtorch.evaluation import metrics
from roadtorch.evaluation.measure import Figures, Measure
from roadtorch.evaluation.report.charts import run_charts
from roadtorch.evaluation.report.montage import write_montages
from roadtorch.evaluation.report.table import page_text
from roadtorch.evaluation.report.tables import run_tables
from roadtorch.evaluation.result import DetectorFigures, Evaluation, image_f

SHEETS = 4  # images of a sheet, if nobody says

COLUMNS = (
    *("image", "group", "detector", "auc", "maxf", "threshold", "f", "f_mask", "iou_mask"),
    *("trust", "ms", "status"),
)


def write(evaluation: Evaluation, out: Path, command: str = "", images: int = SHEETS) -> None:
    """Write everything that stays of a run; the folder has to be there.

    command: what made it, for the record. images: how many the sheets of the best, median
    and worst show; none for 0.
    """
    write_json(out / "metrics.json", document(evaluation, command))
    write_text(out / "images.csv", csv_text(COLUMNS, image_rows(evaluation)))
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


def image_rows(evaluation: Evaluation) -> Iterator[Mapping[str, str]]:
    """Yield a row of images.csv for each image and detector, and for each image that failed.

    f is at the threshold of the image's group, of its 8-bit map; f_mask and iou_mask are of the
    detector's own mask; trust is its expected F. Undefined values are empty.
    """
    left_out = evaluation.left_out
    for name, tally in evaluation.tallies.items():
        kept, thresholds = tally.kept(), evaluation.detectors[name].thresholds
        columns = {
            "auc": kept.auc.tolist(),
            "maxf": kept.max_f.tolist(),
            "threshold": [thresholds[group] for group in kept.groups],
            "f": image_f(kept, thresholds).tolist(),
            "f_mask": metrics.f_measure(kept.mask).tolist(),
            "iou_mask": metrics.iou(kept.mask).tolist(),
            "trust": kept.trust.tolist(),
        }
        for place, (image, group) in enumerate(zip(kept.names, kept.groups, strict=True)):
            values = {key: column[place] for key, column in columns.items()}
            yield {
                "image": image,
                "group": group,
                "detector": name,
                **{key: "" if isnan(value) else f"{value:.6f}" for key, value in values.items()},
                "ms": f"{1000 * float(kept.seconds[place]):.2f}",
                "status": "left out" if group in left_out else "ok",
            }
    for failure in evaluation.failures:
        yield {"image": failure.image, "group": failure.group or "", "status": failure.reason}


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
        "view": "the image" if dataset.view is None else dataset.view.name,
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
    return None if isinstance(value, float) and isnan(value) else value
