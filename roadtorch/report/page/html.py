"""report.html: what a run found, in one file that a person can read without anything else."""

import base64
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from markupsafe import Markup

from roadtorch.errors import InputError
from roadtorch.evaluation.group_curves import RunCurves
from roadtorch.evaluation.result import Evaluation
from roadtorch.evaluation.summary import PictureRow
from roadtorch.io.atomic import write_text
from roadtorch.report.page import charts, tables
from roadtorch.report.page.outcome import outcome
from roadtorch.report.page.part_tables import part_tables
from roadtorch.report.page.svg import MOST, Series, choose_series
from roadtorch.report.parts import condition_rows, group_rows
from roadtorch.report.templates import template
from roadtorch.version import __version__

WIDEST = 1200  # pixels of a sheet; ours: as wide as the page shows it

JPEG_QUALITY = 80  # of sheets; ours: no artefact is seen at the size they are shown

MOST_FAILURES = 200  # listed; metrics.json has them all

PARTS = {"best": "Best", "median": "Median", "worst": "Worst"}  # sheets, in this order

Sheets = Mapping[str, Mapping[str, bytes]]
"""By detector: the pictures ``best``, ``median`` and ``worst``, as JPEG or PNG."""


def write_page(
    path: Path,
    evaluation: Evaluation,
    curves: RunCurves,
    rows: Sequence[PictureRow],
    sheets: Sheets,
    command: str = "",
) -> None:
    """Write the report of a run; see `render_page`."""
    write_text(path, render_page(evaluation, curves, rows, sheets, command))


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

    Raises InputError for a sheet that is no picture.
    """
    detectors, dataset = evaluation.detectors, evaluation.dataset
    series = choose_series(evaluation)
    drawn = charts.all_charts(evaluation, series, curves, rows)
    text = template("page/report.html").render(
        evaluation=evaluation,
        dataset=dataset,
        view="the picture" if dataset.view is None else dataset.view.name,
        version=__version__,
        command=command,
        series=series,
        groups=_groups(evaluation),
        baselines={name for name, one in detectors.items() if one.is_baseline},
        left_out=len(detectors) - len(series),
        outcome=outcome(evaluation),
        tables=tables.all_tables(evaluation, series),
        layouts=tables.layouts(evaluation, series),
        by_group=part_tables(evaluation, series, group_rows),
        by_condition=part_tables(evaluation, series, condition_rows),
        measures=tables.measures_shown(evaluation),
        charts={name: Markup(svg) for name, svg in drawn.items()},
        sheets=list(_sheets(sheets, evaluation)),
        sheets_left_out=max(len(sheets) - MOST, 0),
        failures=evaluation.failures[:MOST_FAILURES],
        failures_left_out=max(len(evaluation.failures) - MOST_FAILURES, 0),
        settings=_settings(evaluation, series),
        sources=sorted({one.threshold_from for one in detectors.values()} - {""}),
    )
    # A file name may hold bytes that are no text.
    return text.encode("utf-8", "backslashreplace").decode()


def _groups(evaluation: Evaluation) -> dict[str, int]:
    """How many pictures were scored of each group."""
    items = Counter(item.group for item in evaluation.dataset.items)
    failed = Counter(one.group for one in evaluation.failures)
    groups = sorted([*evaluation.groups, *evaluation.left_out])
    return {group: items[group] - failed[group] for group in groups}


def _settings(evaluation: Evaluation, series: Sequence[Series]) -> dict[str, str]:
    """Settings as text, of the detectors that charts show and that have any."""
    given = {one.name: evaluation.detectors[one.name].method.settings for one in series}
    return {
        name: json.dumps(settings, indent=2, ensure_ascii=False)
        for name, settings in given.items()
        if settings
    }


# --- pictures ---------------------------------------------------------------------------


def _sheets(sheets: Sheets, evaluation: Evaluation) -> Iterator[tuple[str, list[dict[str, str]]]]:
    """(detector, its sheets) of the best detectors that have some."""
    names = [name for name in evaluation.ranked() if sheets.get(name)]
    for name in names[:MOST]:
        yield (
            name,
            [_sheet(name, part, sheets[name][part]) for part in PARTS if part in sheets[name]],
        )


def _sheet(name: str, part: str, data: bytes) -> dict[str, str]:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if picture is None:
        raise InputError(f"{name}, {part} pictures", "is not a picture", "give JPEG or PNG")
    scale = min(1.0, WIDEST / picture.shape[1])
    picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    height, width = picture.shape[:2]
    uri = f"data:image/jpeg;base64,{base64.b64encode(small).decode()}"
    return {"title": PARTS[part], "uri": uri, "width": str(width), "height": str(height)}
