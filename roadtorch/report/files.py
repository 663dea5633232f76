"""What a run leaves behind in a folder: figures, curves, rows, sheets of pictures, the page."""

import math
from collections.abc import Collection, Sequence
from dataclasses import asdict, fields
from itertools import chain
from pathlib import Path

from roadtorch.evaluation.document import defined, document
from roadtorch.evaluation.group_curves import RunCurves, group_curves
from roadtorch.evaluation.result import Evaluation, Failure
from roadtorch.evaluation.summary import PictureRow, picture_rows
from roadtorch.io.atomic import csv_text, write_json, write_text
from roadtorch.oneclass import CLASSIFIERS
from roadtorch.report.montage import write_montages
from roadtorch.report.page.html import write_page
from roadtorch.report.page.roc_families import write_roc_families
from roadtorch.report.table3 import FAMILY, HALVES, table_csv, table_html, table_text

SHEETS = 4  # pictures of a sheet, if nobody says

COLUMNS = (*(each.name for each in fields(PictureRow)), "status")


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
    write_table3(out, evaluation, curves)
    sheets = write_montages(out, evaluation, pictures) if pictures else {}
    write_page(out / "report.html", evaluation, curves, rows, sheets, command)


def write_table3(out: Path, evaluation: Evaluation, curves: RunCurves) -> None:
    """Write table3.txt, .csv and .html, and the ROC curves as P3's Figs. 8 and 9 have them.

    Nothing is written where no one-class detector ran.
    """
    text = table_text(evaluation)
    if not text:
        return
    write_text(out / "table3.txt", text + "\n")
    write_text(out / "table3.csv", table_csv(evaluation))
    write_text(out / "table3.html", table_html(evaluation))
    histograms = [name for name in CLASSIFIERS if name.startswith("hist")]
    others = [name for name in CLASSIFIERS if name not in histograms]
    for file, names in {"fig8.svg": histograms, "fig9.svg": others}.items():
        write_roc_families(out / file, curves, FAMILY, names, HALVES)


def rows_csv(
    rows: Sequence[PictureRow], failures: Sequence[Failure], left_out: Collection[str] = ()
) -> str:
    """CSV text: a line for each picture and detector, then one for each picture that failed.

    left_out: groups whose pictures say so, since no mean counts them.
    """
    scored = (
        {key: _cell(value) for key, value in asdict(row).items()}
        | {"ms": f"{row.ms:.2f}", "status": "left out" if row.group in left_out else "ok"}
        for row in rows
    )
    failed = (
        {"image": one.image, "group": one.group or "", "status": one.reason} for one in failures
    )
    return csv_text(COLUMNS, chain(scored, failed))


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return value
    return "" if math.isnan(value) else f"{value:.6f}"
