"""report.html: what a run found, in one file that a person can read without anything else."""

import base64
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import jinja2
import numpy as np
from markupsafe import Markup

from roadtorch.errors import InputError
from roadtorch.files import write_text
from roadtorch.report.page import charts, tables
from roadtorch.report.page.charts import Curves
from roadtorch.report.page.outcome import outcome
from roadtorch.report.page.svg import MOST, Series, choose_series, is_floor, ranked_names

WIDEST = 1200  # pixels of a sheet; ours: as wide as the page shows it

JPEG_QUALITY = 80  # of sheets; ours: no artefact is seen at the size they are shown

MOST_FAILURES = 200  # listed; metrics.json has them all

PARTS = {"best": "Best", "median": "Median", "worst": "Worst"}  # sheets, in this order

Sheets = Mapping[str, Mapping[str, bytes]]
"""By detector: the pictures ``best``, ``median`` and ``worst``, as JPEG or PNG."""


def write_report(
    path: Path,
    document: Mapping[str, Any],
    curves: Curves,
    rows: Sequence[Mapping[str, Any]],
    sheets: Sheets,
) -> None:
    """Write the report of a run; see `render_report`."""
    write_text(path, render_report(document, curves, rows, sheets))


def render_report(
    document: Mapping[str, Any],
    curves: Curves,
    rows: Sequence[Mapping[str, Any]],
    sheets: Sheets,
) -> str:
    """The page: text that needs no other file and asks for none.

    document: the content of metrics.json. curves: see `roadtorch.evaluation.outlines`. rows:
    the figures of single pictures, with ``group``, ``detector`` and ``f``. sheets: pictures to
    look at. What is missing in any of them is left out; what is undefined is a dash.

    Raises InputError for a sheet that is no picture.
    """
    detectors = document["detectors"]
    series = choose_series(detectors)
    page = _environment().from_string(
        files("roadtorch.report.page").joinpath("report.html").read_text(encoding="utf-8")
    )
    text = page.render(
        document=document,
        series=series,
        drives=_drives(detectors),
        left_out=len(detectors) - len(series),
        outcome=outcome(document),
        tables=tables.all_tables(document, series),
        layouts=tables.layouts(detectors, series),
        measures=tables.measures_shown(detectors),
        charts={name: Markup(svg) for name, svg in _charts(document, series, curves, rows).items()},
        sheets=list(_sheets(sheets, detectors)),
        sheets_left_out=max(len(sheets) - MOST, 0),
        failures=document.get("failed", [])[:MOST_FAILURES],
        failures_left_out=max(len(document.get("failed", [])) - MOST_FAILURES, 0),
        settings=_settings(detectors, series),
        sources=sorted({str(one.get("threshold_from") or "") for one in detectors.values()} - {""}),
    )
    # A file name may hold bytes that are no text.
    return text.encode("utf-8", "backslashreplace").decode()


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters["sha256"] = _sha256
    environment.tests["floor"] = is_floor
    return environment


def _sha256(script: str) -> str:
    """The name by which a content security policy allows one script and no other."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _charts(
    document: Mapping[str, Any],
    series: Sequence[Series],
    curves: Curves,
    rows: Sequence[Mapping[str, Any]],
) -> dict[str, str]:
    """SVG by name; empty where there is nothing to draw."""
    return {
        "maxf": charts.maxf_chart(series, document["detectors"]),
        "paired": charts.difference_chart(series, document.get("paired") or {}, "maxf"),
        "roc": charts.roc_chart(series, curves),
        "pr": charts.precision_chart(series, curves),
        "reliability": charts.reliability_chart(series, curves),
        "pictures": charts.distribution_chart(series, rows),
    }


def _drives(detectors: Mapping[str, Mapping[str, Any]]) -> dict[str, int | None]:
    """How many pictures each drive has, where that is known."""
    return {
        drive: next((part["images"] for part in parts if "images" in part), None)
        for drive in tables.drive_names(detectors)
        for parts in [[one.get("groups", {}).get(drive, {}) for one in detectors.values()]]
    }


def _settings(
    detectors: Mapping[str, Mapping[str, Any]], series: Sequence[Series]
) -> dict[str, str]:
    """Settings as text, of the detectors that charts show and that have any."""
    return {
        one.name: json.dumps(detectors[one.name]["settings"], indent=2, ensure_ascii=False)
        for one in series
        if detectors[one.name].get("settings")
    }


# --- pictures ---------------------------------------------------------------------------


def _sheets(
    sheets: Sheets, detectors: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, list[dict[str, str]]]]:
    """(detector, its sheets) of the best detectors that have some."""
    names = [name for name in ranked_names(detectors) if sheets.get(name)]
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
