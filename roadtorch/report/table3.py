"""P3's Table III from a run of one-class detectors: text, CSV and HTML, beside P3's values.

A cell is the mean AUC of single pictures in percent; where a set has drives, the mean over
them. P3 does not say which average it took.
"""

import csv
import html
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, TypeGuard

import numpy as np

from roadtorch.color import REPRESENTATIONS
from roadtorch.files import write_text
from roadtorch.oneclass import CLASSIFIERS

FAMILY = "oneclass:"

SINGLE = tuple(name for name, planes in REPRESENTATIONS.items() if len(planes) == 1)

COMBINED = tuple(name for name in REPRESENTATIONS if name not in SINGLE)

HALVES = {"single planes": SINGLE, "combinations": COMBINED}

Table = Mapping[tuple[str, str], float]
"""AUC in percent by classifier and representation."""

PRINTED = """
                   R    G    B   nr   ng   O1   O2    L    a    b    H    S    V
nn              74.2 72.7 87.8 84.4 56.6 72.3 88.3 70.6 63.8 90.1 78.9 87.1 83.5
hist64_s        73.7 74.1 74.9 76.4 73.5 75.4 75.4 73.8 76.6 77.9 79.7 76.4 73.7
hist64_sn       76.1 76.7 78.2 76.4 73.5 75.3 75.5 77.4 76.7 77.9 79.6 76.8 77.3
hist100_s       73.4 73.8 74.5 77.0 74.8 76.3 76.6 73.5 77.0 78.5 79.7 76.9 73.4
hist100_sn      76.1 76.6 78.2 77.0 74.7 76.3 76.7 77.4 77.1 78.5 79.7 77.4 77.3
gaussian        75.7 83.1 87.8 87.9 56.3 67.6 92.0 78.8 68.4 92.5 85.5 92.8 83.6
robust_gaussian 75.7 83.1 87.8 87.9 56.5 67.6 92.0 78.8 68.5 92.5 85.5 92.8 83.6
mog2            74.2 74.4 76.2 75.5 75.6 75.8 77.4 74.7 76.5 78.7 78.6 76.0 74.8
mog4            79.3 80.1 81.8 80.0 78.2 78.3 79.3 80.2 79.9 78.7 81.3 78.9 80.5
mog_opt         75.8 83.1 87.5 88.3 56.3 67.6 92.0 78.8 67.9 92.2 86.2 92.8 83.6
svdd            75.8 83.2 87.7 88.2 55.7 68.4 91.9 78.8 67.5 92.5 83.9 92.9 83.7
pca                -    -    -    -    -    -    -    -    -    -    -    -    -
mpm             75.8 83.1 87.7 88.0 56.3 67.8 92.0 78.8 68.2 92.5 86.7 92.9 83.7
mst             75.5 83.1 87.9 87.2 56.5 68.1 91.5 78.8 67.0 92.2 86.1 92.8 83.6
dlp             75.8 83.2 87.7 88.2 55.7 68.4 91.8 78.8 67.5 92.5 83.3 92.9 83.6
kmeans          75.4 83.1 87.6 87.3 56.3 68.3 91.4 78.7 68.7 92.3 84.8 92.8 83.7
kcentres        75.3 83.0 88.0 87.5 56.8 68.1 91.3 78.8 66.9 92.1 84.8 92.8 83.6

                 RGB nrng O1O2  Lab  HSV   HS
nn              83.1 88.2 91.1 86.6 85.1 91.6
hist64_s        58.0 54.2 68.2 54.9 53.8 53.2
hist64_sn       70.6 55.4 68.3 53.4 62.8 63.0
hist100_s       55.8 54.0 68.9 53.9 53.2 53.6
hist100_sn      61.4 55.7 59.5 53.7 57.6 62.3
gaussian        90.9 90.0 92.9 90.9 91.6 93.2
robust_gaussian 90.0 89.4 93.0 91.4 79.1 93.4
mog2            85.6 85.8 83.3 86.1 86.3 84.8
mog4            88.3 88.6 84.8 88.3 88.5 86.3
mog_opt         84.5 90.8 85.7 75.4 84.4 88.2
svdd            81.7 91.0 91.9 85.3 84.6 92.7
pca             91.6    -    - 91.2 89.3    -
mpm             81.7 90.9 92.0 85.3 84.6 92.8
mst             82.8 90.9 92.1 86.5 85.0 93.0
dlp             81.7 91.1 91.9 85.3 84.6 92.7
kmeans          82.7 91.1 92.1 86.2 85.1 93.0
kcentres        82.6 91.5 92.2 86.3 84.9 93.1
"""
"""Table III of P3, arXiv 1412.3506: its two halves, empty cells as dashes."""


def printed_table() -> dict[tuple[str, str], float]:
    """P3's own values, 307 of them."""
    found = {}
    for block in PRINTED.strip("\n").split("\n\n"):
        columns, *rows = (line.split() for line in block.splitlines())
        for name, *values in rows:
            cells = zip(columns, values, strict=True)
            found |= {(name, planes): float(value) for planes, value in cells if value != "-"}
    return found


# --- figures ----------------------------------------------------------------------------


def measured_table(detectors: Mapping[str, Mapping[str, Any]], drive: str | None = None) -> Table:
    """The cells of a run, of all of it or of one drive; empty where no one-class detector ran.

    detectors: as in metrics.json. Cells without an AUC are left out.
    """
    found = {}
    for classifier in CLASSIFIERS:
        for planes in REPRESENTATIONS:
            figures = detectors.get(f"{FAMILY}{classifier}:{planes}", {})
            part = figures if drive is None else figures.get("groups", {}).get(drive, {})
            value = part.get("auc_mean")
            if _known(value):
                found[classifier, planes] = 100 * value
    return found


def _known(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def best_cells(table: Table, columns: Sequence[str]) -> set[tuple[str, str]]:
    """The best classifiers of each column, to the one decimal that is printed."""
    best = set()
    for planes in columns:
        cells = {key: round(value, 1) for key, value in table.items() if key[1] == planes}
        best |= {key for key, value in cells.items() if value == max(cells.values())}
    return best


def rank_correlations(ours: Table, paper: Table) -> Iterator[tuple[str, int, float]]:
    """Spearman's coefficient between two tables: what over, how many pairs, the coefficient.

    Over the cells that both have, of all and of each half; and over the means of columns and
    of rows. Where there is nothing to rank, nothing is said.
    """
    from scipy.stats import rankdata  # slow to import, and most runs do without

    for name, pairs in _compared(ours, paper):
        ranks = [rankdata(values) for values in zip(*pairs, strict=True)]
        if ranks and all(np.ptp(one) > 0 for one in ranks):
            yield name, len(pairs), float(np.corrcoef(ranks)[0, 1])


def _compared(ours: Table, paper: Table) -> Iterator[tuple[str, Sequence[tuple[float, float]]]]:
    """What ``rank_correlations`` is over, and the pairs of values."""
    both = [key for key in ours if key in paper]
    parts = {"all cells": both}
    parts |= {name: [key for key in both if key[1] in HALVES[name]] for name in HALVES}
    for name, keys in parts.items():
        yield name, [(ours[key], paper[key]) for key in keys]
    for half in HALVES:
        for name, place in (("columns", 1), ("rows", 0)):
            groups: dict[str, list[tuple[str, str]]] = {}
            for key in parts[half]:
                groups.setdefault(key[place], []).append(key)
            means = [[fmean(table[key] for key in keys) for keys in groups.values()]
                     for table in (ours, paper)]  # fmt: skip
            yield f"means of {name}, {half}", list(zip(*means, strict=True))


# --- text, CSV, HTML --------------------------------------------------------------------


def table_text(document: Mapping[str, Any]) -> str:
    """The table of a run as text, ours/P3's, the best of a column between stars; "" without one.

    document: the content of metrics.json.
    """
    ours, paper = measured_table(document["detectors"]), printed_table()
    if not ours:
        return ""
    parts = [_heading(document)]
    for half, columns in HALVES.items():
        if lines := _lines(ours, paper, columns):
            parts.append("\n".join([f"{half}: ours/P3, * best of the column", *lines]))
    ranks = [f"  {name} ({n}): {value:+.2f}" for name, n, value in rank_correlations(ours, paper)]
    return "\n\n".join([*parts, "\n".join(["Spearman's rank correlation with P3", *ranks])])


def _heading(document: Mapping[str, Any]) -> str:
    drives = _drives(document)
    over = f", mean over {', '.join(drives)}" if drives else ""
    floors = [
        f"{name} {100 * value:.1f}"
        for name, figures in document["detectors"].items()
        if name.startswith("prior:") and _known(value := figures["auc_mean"])
    ]
    beside = f"; floors: {', '.join(floors)}" if floors else ""
    set_ = " ".join(filter(None, (document["dataset"], document["split"])))
    return (
        f"One-class classifiers, mean AUC of {document['images']} pictures of {set_}{over}{beside}"
    )


def _drives(document: Mapping[str, Any]) -> list[str]:
    every = document["detectors"].values()
    return sorted({drive for figures in every for drive in figures.get("groups", {})})


def _lines(ours: Table, paper: Table, columns: Sequence[str]) -> list[str]:
    best = best_cells(ours, columns)
    rows, columns = _measured(ours, columns)
    lines = ["classifier".ljust(16) + "".join(planes.rjust(12) for planes in columns)] * bool(rows)
    for name in rows:
        line = name.ljust(16)
        for key in ((name, planes) for planes in columns):
            cell = f"{_cell(ours, key)}/{_cell(paper, key)}"
            line += " " + (f"*{cell}" if key in best else cell).rjust(11)
        lines.append(line)
    return lines


def _measured(ours: Table, columns: Sequence[str]) -> tuple[list[str], list[str]]:
    """The classifiers and those of the columns in which there is any value."""
    columns = [planes for planes in columns if any(key[1] == planes for key in ours)]
    rows = [name for name in CLASSIFIERS if any((name, planes) in ours for planes in columns)]
    return rows, columns


def _cell(table: Table, key: tuple[str, str]) -> str:
    return f"{table[key]:.1f}" if key in table else "-"


def table_csv(document: Mapping[str, Any]) -> str:
    """One row a cell: classifier, representation, auc, P3's, and that of each drive."""
    drives, paper = _drives(document), printed_table()
    by_drive = [measured_table(document["detectors"], drive) for drive in drives]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["classifier", "representation", "auc", "paper", *drives])
    for key, value in measured_table(document["detectors"]).items():
        own = [f"{table[key]:.2f}" if key in table else "" for table in by_drive]
        writer.writerow([*key, f"{value:.2f}", paper.get(key, ""), *own])
    return file.getvalue()


STYLE = """body{font:15px sans-serif;margin:2em}table{border-collapse:collapse;margin:1em 0}
td,th{padding:.2em .6em;text-align:right;border-bottom:1px solid #ccc}
tr>:first-child{text-align:left}small{color:#777}caption{text-align:left;font-weight:bold}"""


def table_html(document: Mapping[str, Any]) -> str:
    """A page: the table of a run, one of each drive, the best in bold, P3's values small."""
    detectors, paper = document["detectors"], printed_table()
    tables = {"all": measured_table(detectors)}
    tables |= {drive: measured_table(detectors, drive) for drive in _drives(document)}
    body = [f"<p>{html.escape(_heading(document))}. In percent; P3's values small.</p>"]
    body += [
        _html_half(f"{title}, {half}", table, paper, columns)
        for title, table in tables.items()
        for half, columns in HALVES.items()
    ]
    ranks = rank_correlations(tables["all"], paper)
    told = "".join(f"<li>{name} ({count}): {value:+.2f}</li>" for name, count, value in ranks)
    body.append(f"<p>Spearman's rank correlation with P3</p><ul>{told}</ul>")
    head = f"<meta charset='utf-8'><title>One-class classifiers</title><style>{STYLE}</style>"
    return "\n".join([f"<!doctype html>{head}", *body, ""])


def _html_half(title: str, ours: Table, paper: Table, columns: Sequence[str]) -> str:
    best = best_cells(ours, columns)
    names, columns = _measured(ours, columns)
    if not names:
        return ""
    rows = ["<tr><th>classifier</th>" + "".join(f"<th>{name}</th>" for name in columns) + "</tr>"]
    for name in names:
        cells = []
        for key in ((name, planes) for planes in columns):
            value = f"<b>{_cell(ours, key)}</b>" if key in best else _cell(ours, key)
            cells.append(f"<td>{value} <small>{_cell(paper, key)}</small></td>")
        rows.append(f"<tr><td>{name}</td>{''.join(cells)}</tr>")
    return "\n".join([f"<table><caption>{html.escape(title)}</caption>", *rows, "</table>"])


def write_table3(out: Path, document: Mapping[str, Any], curves: Mapping[str, Any]) -> None:
    """Write table3.txt, .csv and .html, and the ROC curves as P3's Figs. 8 and 9 have them.

    document, curves: the contents of metrics.json and curves.json. Nothing is written where no
    one-class detector ran.
    """
    from roadtorch.report.page.roc_families import write_roc_families

    text = table_text(document)
    if not text:
        return
    write_text(out / "table3.txt", text + "\n")
    write_text(out / "table3.csv", table_csv(document))
    write_text(out / "table3.html", table_html(document))
    histograms = [name for name in CLASSIFIERS if name.startswith("hist")]
    others = [name for name in CLASSIFIERS if name not in histograms]
    for file, names in {"fig8.svg": histograms, "fig9.svg": others}.items():
        write_roc_families(out / file, curves, FAMILY, names, HALVES)
