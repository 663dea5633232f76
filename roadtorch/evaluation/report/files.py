"""Files of an evaluation: metrics.json, images.csv, tables.md, montages and report.html."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from math import isnan
from pathlib import Path
from typing import Any

from roadtorch.base.atomic import csv_text, write_json, write_text
from roadtorch.base.version import __version__
from roadtorch.evaluation import metrics
from roadtorch.evaluation.measure import Measure, Scores
from roadtorch.evaluation.report.charts import build_charts
from roadtorch.evaluation.report.montage import write_montages
from roadtorch.evaluation.report.table import Images, Section, Table, render_page
from roadtorch.evaluation.report.tables import build_tables
from roadtorch.evaluation.result import DetectorScores, Evaluation, image_f

EXAMPLES = 4  # images of a montage by default

TABLE_NOTE = (
    "Scores are means over the groups, if any. Grey rows are baselines that ignore the image. "
    "Bold: best of a column, or a difference whose interval excludes 0."
)

CHART_NOTE = (
    "ROC: mean over the groups, if any, at each false positive rate; thin lines are the groups of "
    "the best detector; right: the corner enlarged. Reliability: fraction of road among the pixels "
    "of each likelihood; on the diagonal the likelihood is a probability."
)

MONTAGE_NOTE = (
    "Ranked by F at their group's threshold. From left to right: image, cues of the detector, "
    "likelihood (dark blue 0, yellow 1), mask (blue) with the outline of the true road "
    "(vermillion); void is dark."
)

GLOSSARY = {
    "95 %": "Bootstrap interval over images, resampled within each group. Neighbouring images are "
    "similar, so the true uncertainty is larger; other cameras are not covered.",
    "–": "Undefined, for example without road in the truth.",
}

IMAGE_COLUMNS = (
    *("image", "group", "detector", "auc", "maxf", "threshold", "f", "f_mask", "iou_mask"),
    *("trust", "ms", "status"),
)


def write_report(
    evaluation: Evaluation, out: Path, command: str = "", images: int = EXAMPLES
) -> None:
    """Write all files of an evaluation; the folder has to exist.

    command: the command line, for the record. images: number of images in the montages of the best,
    median and worst; 0 for no montage.
    """
    write_json(out / "metrics.json", build_document(evaluation, command))
    write_text(out / "images.csv", csv_text(IMAGE_COLUMNS, image_rows(evaluation)))
    tables = build_tables(evaluation)
    write_text(out / "tables.md", "\n".join(table.to_markdown() for table in tables))
    montages = write_montages(out, evaluation, images) if images else []
    write_text(out / "report.html", build_page(evaluation, tables, montages, command))


def build_page(
    evaluation: Evaluation, tables: Sequence[Table], montages: Images, command: str
) -> str:
    """Return report.html: tables, charts and montages, and the meaning of each measure."""
    dataset, groups, failures = evaluation.dataset, evaluation.groups, evaluation.failures
    left_out, count = ", ".join(evaluation.left_out), len(groups) + len(evaluation.left_out)
    facts = [
        f"{evaluation.images} images" + (f" of {count} groups" if groups else ""),
        f"{left_out} left out of all means and thresholds" if left_out else "",
        f"scored in {dataset.space_name}; void is ignored",
        "images that failed are not scored for any detector" if failures else "",
    ]
    charts = list(build_charts(evaluation).items())  # the first is as wide as the page
    keys = set(chain.from_iterable(part.headline for part in evaluation.detectors.values()))
    measures = [m for m in evaluation.measures if m.tables and m.key in keys]
    sections = [
        Section("", TABLE_NOTE, tables),
        Section("Charts", CHART_NOTE, images=charts[:1], charts=charts[1:]),
        *([Section("Images", MONTAGE_NOTE, images=montages)] if montages else []),
    ]
    return render_page(
        ", ".join(filter(None, [f"Road detection on {dataset.name}", dataset.split])),
        "; ".join(filter(None, facts)) + ".",
        sections,
        command=command,
        failures=failures,
        glossary={measure.name: measure.meaning for measure in measures} | GLOSSARY,
    )


def image_rows(evaluation: Evaluation) -> Iterator[Mapping[str, str]]:
    """Yield a row of images.csv for each image and detector, and for each image that failed.

    f is at the threshold of the image's group, from its 8-bit map; f_mask and iou_mask are of the
    detector's own mask; trust is its predicted F. Undefined values are empty.
    """
    left_out = evaluation.left_out
    for name, tally in evaluation.tallies.items():
        table, thresholds = tally.table(), evaluation.detectors[name].thresholds
        columns = {
            "auc": table.auc.tolist(),
            "maxf": table.max_f.tolist(),
            "threshold": [thresholds[group] for group in table.groups],
            "f": image_f(table, thresholds).tolist(),
            "f_mask": metrics.f_measure(table.mask).tolist(),
            "iou_mask": metrics.iou(table.mask).tolist(),
            "trust": table.trust.tolist(),
        }
        for row, (image, group) in enumerate(zip(table.names, table.groups, strict=True)):
            values = {key: column[row] for key, column in columns.items()}
            yield {
                "image": image,
                "group": group,
                "detector": name,
                **{key: "" if isnan(value) else f"{value:.6f}" for key, value in values.items()},
                "ms": f"{1000 * float(table.seconds[row]):.2f}",
                "status": "left out" if group in left_out else "ok",
            }
    for failure in evaluation.failures:
        yield {"image": failure.image, "group": failure.group or "", "status": failure.reason}


# --- metrics.json -----------------------------------------------------------------------


def build_document(evaluation: Evaluation, command: str) -> dict[str, Any]:
    """Return the content of metrics.json: the run, then every detector's scores."""
    dataset, measures = evaluation.dataset, evaluation.measures
    return _nan_to_none({
        "roadtorch": __version__,
        "dataset": dataset.name,
        "split": dataset.split,
        "images": evaluation.images,
        "void": "ignored",
        "command": command,
        "levels": dataset.levels,
        "view": dataset.space_name,
        "left_out": evaluation.left_out,
        "failed": [
            {"image": failure.image, "reason": failure.reason} for failure in evaluation.failures
        ],
        "detectors": {
            name: _detector(values, measures) for name, values in evaluation.detectors.items()
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


def _detector(scores: DetectorScores, measures: Sequence[Measure]) -> dict[str, object]:
    content = {
        **_nest(scores.headline),
        "maxf_threshold": scores.best_threshold,
        "threshold_from": scores.threshold_from,
    }
    if scores.groups:
        content["groups"] = {group: _nest(values) for group, values in scores.groups.items()}
        content["left_out"] = {group: _nest(values) for group, values in scores.left_out.items()}
        content["pooled"] = _nest(scores.pooled)
    if scores.conditions:
        content["conditions"] = {name: _nest(part) for name, part in scores.conditions.items()}
    content["ci95"] = {
        measure.key.replace("/", "_"): scores.intervals[measure.key]
        for measure in measures
        if measure.key in scores.intervals
    }
    return {
        **content,
        "threshold_default": scores.contender.threshold,
        "settings": scores.contender.settings,
        "runtime": scores.contender.runtime,
        "baseline": scores.is_baseline,
    }


def _nest(values: Scores) -> dict[str, object]:
    """Return scores with keys like "layout/mean" as nested mappings."""
    levels: dict[str, Any] = {}
    for key, value in values.items():
        *outer, last = key.split("/")
        branch = levels
        for name in outer:
            branch = branch.setdefault(name, {})
        branch[last] = value
    return levels


def _nan_to_none(value: Any) -> Any:
    """Return a JSON value with None for every NaN."""
    if isinstance(value, Mapping):
        return {key: _nan_to_none(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_nan_to_none(part) for part in value]
    return None if isinstance(value, float) and isnan(value) else value
