"""What a run leaves behind in a folder: figures, curves, rows, sheets of pictures, the page.

report.html says what a run found, in one file that a person can read without anything else.
"""

import json
import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, fields
from itertools import chain
from pathlib import Path
from typing import Any

from markupsafe import Markup

from roadtorch.base.atomic import csv_text, write_json, write_text
from roadtorch.evaluation.document import RunCurves, defined, document, group_curves
from roadtorch.evaluation.report import charts
from roadtorch.evaluation.report.montage import write_montages
from roadtorch.evaluation.report.screen import outcome
from roadtorch.evaluation.report.svg import MAX_SERIES, choose_series
from roadtorch.evaluation.report.table import page_text
from roadtorch.evaluation.report.tables import baselines, measures_shown, page_tables
from roadtorch.evaluation.result import Evaluation, Failure, PictureRow, picture_rows

SHEETS = 4  # pictures of a sheet, if nobody says

COLUMNS = (*(each.name for each in fields(PictureRow)), "status")

MAX_FAILURES = 200  # listed; metrics.json has them all

PARTS = {"best": "Best", "median": "Median", "worst": "Worst"}  # sheets, in this order

Sheets = Mapping[str, Mapping[str, Mapping[str, str]]]
"""By detector: the pictures ``best``, ``median`` and ``worst``, as ``montage.on_page`` has them."""


def write(evaluation: Evaluation, out: Path, command: str = "", pictures: int = SHEETS) -> None:
    """Write everything that stays of a run; the folder has to be there.

    command: what made it, for the record. pictures: how many the sheets of the best, median
    and worst show; none for 0.
    """
    curves = {
        name: group_curves(tally, evaluation.detectors[name].counting)
        for name, tally in evaluation.tallies.items()
    }
    rows = [
        row
        for name, tally in evaluation.tallies.items()
        for row in picture_rows(name, tally, evaluation.detectors[name])
    ]
    write_json(out / "metrics.json", defined(document(evaluation, command)))
    write_json(out / "curves.json", defined(curves))
    write_text(out / "images.csv", rows_csv(rows, evaluation.failures, evaluation.left_out))
    sheets = write_montages(out, evaluation, pictures) if pictures else {}
    write_text(out / "report.html", render_page(evaluation, curves, rows, sheets, command))


def rows_csv(
    rows: Sequence[PictureRow], failures: Sequence[Failure], left_out: Collection[str] = ()
) -> str:
    """CSV text: a line for each picture and detector, then one for each picture that failed.

    left_out: groups whose pictures say so, since no mean counts them.
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


# --- the page ---------------------------------------------------------------------------


def render_page(
    evaluation: Evaluation,
    curves: RunCurves,
    rows: Sequence[PictureRow],
    sheets: Sheets,
    command: str = "",
) -> str:
    """The page: text that needs no other file and asks for none.

    rows: the figures of single pictures. sheets: pictures to look at. command: what made
    the run, for the record. What is missing in any of them is left out; what is undefined is
    a dash.
    """
    detectors, dataset = evaluation.detectors, evaluation.dataset
    series = choose_series(evaluation)
    in_charts = [detector.name for detector in series]
    drawn = charts.all_charts(evaluation, series, curves, rows)
    settings = {name: detectors[name].contender.settings for name in in_charts}
    groups = [*evaluation.groups, *evaluation.left_out]
    scored = Counter(item.group for item in dataset.items)
    scored.subtract(failure.group for failure in evaluation.failures)
    values: dict[str, Any] = {
        "evaluation": evaluation,
        "dataset": dataset,
        "title": dataset.root.resolve().name if dataset.name == "folder" else dataset.name,
        "view": "the picture" if dataset.view is None else dataset.view.name,
        "series": series,
        "groups": {group: scored[group] for group in sorted(groups)},
        "baselines": baselines(evaluation),
        "left_out": len(detectors) - len(series),
        "outcome": outcome(evaluation),
        "tables": page_tables(evaluation, in_charts),
        "measures": measures_shown(evaluation),
        "charts": {name: Markup(svg) for name, svg in drawn.items()},
        "sheets": {
            name: {PARTS[part]: sheets[name][part] for part in PARTS if part in sheets[name]}
            for name in [name for name in evaluation.ranked() if sheets.get(name)][:MAX_SERIES]
        },
        "sheets_left_out": max(len(sheets) - MAX_SERIES, 0),
        "failures": evaluation.failures[:MAX_FAILURES],
        "failures_left_out": max(len(evaluation.failures) - MAX_FAILURES, 0),
        "settings": {
            name: json.dumps(own, indent=2, ensure_ascii=False)
            for name, own in settings.items()
            if own
        },
        "sources": sorted({figures.threshold_from for figures in detectors.values()} - {""}),
    }
    return page_text("report.html", command, values)
