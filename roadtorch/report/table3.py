"""P3's Table III from a run of one-class detectors: text, CSV and HTML, beside P3's values.

A cell is the mean AUC of single pictures in percent; where a set has groups, the mean over
them. P3 does not say which average it took.
"""

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from itertools import product
from statistics import fmean

import numpy as np

from roadtorch.evaluation.measures import AUC_MEAN
from roadtorch.evaluation.result import DetectorFigures, Evaluation
from roadtorch.imaging.color import REPRESENTATIONS
from roadtorch.oneclass import CLASSIFIERS
from roadtorch.report.table import Cell, Table, page_text

FAMILY = "oneclass:"

SINGLE = tuple(name for name, planes in REPRESENTATIONS.items() if len(planes) == 1)

COMBINED = tuple(name for name in REPRESENTATIONS if name not in SINGLE)

HALVES = {"single planes": SINGLE, "combinations": COMBINED}

Percents = Mapping[tuple[str, str], float]
"""AUC in percent by classifier and representation."""

Pairs = Sequence[tuple[float, float]]
"""Ours and P3's."""


def printed_table() -> Percents:
    """P3's own values, 307 of them: Table III of arXiv 1412.3506, both halves side by side."""
    text = files("roadtorch.report").joinpath("table3_printed.csv").read_text(encoding="utf-8")
    return {
        (row["classifier"], planes): float(row[planes])
        for row in csv.DictReader(io.StringIO(text))
        for planes in REPRESENTATIONS
        if row[planes]
    }


# --- figures ----------------------------------------------------------------------------


def measured_table(evaluation: Evaluation, group: str | None = None) -> Percents:
    """The cells of a run, of all of it or of one group; empty where no one-class detector ran.

    Cells without an AUC are left out.
    """
    cells = {
        key: 100 * AUC_MEAN.of(one.headline if group is None else one.group(group))
        for key, one in _cells(evaluation)
    }
    return {key: value for key, value in cells.items() if not math.isnan(value)}


def _cells(evaluation: Evaluation) -> Iterator[tuple[tuple[str, str], DetectorFigures]]:
    """Classifier, representation, and what a run has of it: P3's to the letter where it ran."""
    for key in product(CLASSIFIERS, REPRESENTATIONS):
        name = FAMILY + ":".join(key)
        found = evaluation.detectors
        one = found.get(f"{name}:paper") or found.get(name)
        if one is not None:
            yield key, one


def best_cells(table: Percents, columns: Sequence[str]) -> set[tuple[str, str]]:
    """The best classifiers of each column, to the one decimal that is printed."""
    best = set()
    for planes in columns:
        cells = {key: round(value, 1) for key, value in table.items() if key[1] == planes}
        best |= {key for key, value in cells.items() if value == max(cells.values())}
    return best


def rank_correlations(ours: Percents, paper: Percents) -> Iterator[tuple[str, int, float]]:
    """Spearman's coefficient between two tables: what over, how many pairs, the coefficient.

    Over the cells that both have, of all and of each half; and over the means of columns and
    of rows. Where there is nothing to rank, nothing is said.
    """
    from scipy.stats import rankdata  # slow to import, and most runs do without

    for name, pairs in _compared(ours, paper):
        ranks = [rankdata(values) for values in zip(*pairs, strict=True)]
        if ranks and all(np.ptp(one) > 0 for one in ranks):
            yield name, len(pairs), float(np.corrcoef(ranks)[0, 1])


def _compared(ours: Percents, paper: Percents) -> Iterator[tuple[str, Pairs]]:
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


def table_text(evaluation: Evaluation) -> str:
    """The table of a run as text, ours/P3's, the best of a column between stars; "" without one."""
    ours, paper = measured_table(evaluation), printed_table()
    if not ours:
        return ""
    parts = [_heading(evaluation)]
    for half, columns in HALVES.items():
        if lines := table_lines(ours, paper, columns):
            parts.append("\n".join([f"{half}: ours/the paper's, * best of the column", *lines]))
    if note := letter_note(evaluation):
        parts.append(note)
    ranks = [f"  {name} ({n}): {value:+.2f}" for name, n, value in rank_correlations(ours, paper)]
    return "\n\n".join([*parts, "\n".join(["Spearman's rank correlation with the paper", *ranks])])


def _heading(evaluation: Evaluation) -> str:
    over = f", mean over {', '.join(evaluation.groups)}" if evaluation.groups else ""
    baselines = [
        f"{name} {100 * value:.1f}"
        for name, one in evaluation.detectors.items()
        if one.is_baseline and not math.isnan(value := AUC_MEAN.of(one.headline))
    ]
    beside = f"; blind baselines: {', '.join(baselines)}" if baselines else ""
    set_ = " ".join(filter(None, (evaluation.dataset.name, evaluation.dataset.split)))
    pictures = f"mean AUC of {evaluation.images} pictures of {set_}"
    return f"One-class classifiers, {pictures}{over}{beside}"


def letter_note(evaluation: Evaluation) -> str:
    """Which classifiers of a run are not as P3 has them; "" where all are."""
    ours = {
        name
        for (name, _), one in _cells(evaluation)
        if not CLASSIFIERS[name].paper.items()
        <= one.method.settings.get("classifier", CLASSIFIERS[name].paper).items()
    }
    remedy = f"({FAMILY}CLASSIFIER:PLANES:paper is)"
    return f"not the paper's to the letter: {', '.join(sorted(ours))} {remedy}" if ours else ""


def table_lines(ours: Percents, paper: Percents, columns: Sequence[str]) -> list[str]:
    """The classifiers that have a value in one of the columns, a line each, under the names."""
    half = half_table(ours, paper, columns)
    names = "".join(header.rjust(12) for header, _ in half.headers)
    lines = ["classifier".ljust(16) + names] * bool(half.names)
    for name, cells in half.rows():
        texts = [f"{cell.text}/{cell.note}" for cell in cells]
        starred = [
            f"*{text}" if cell.strong else text for text, cell in zip(texts, cells, strict=True)
        ]
        lines.append(name.ljust(16) + "".join(" " + text.rjust(11) for text in starred))
    return lines


def half_table(ours: Percents, paper: Percents, columns: Sequence[str]) -> Table:
    """Classifiers and representations in which there is any value, P3's as notes."""
    best = best_cells(ours, columns)
    columns = [planes for planes in columns if any(key[1] == planes for key in ours)]
    table = Table([name for name in CLASSIFIERS if any((name, one) in ours for one in columns)])
    for planes in columns:
        keys = [(name, planes) for name in table.names]
        cells = [
            Cell(_text(ours, key), ours.get(key), key in best, _text(paper, key)) for key in keys
        ]
        table.add(planes, "", cells)
    return table


def _text(table: Percents, key: tuple[str, str]) -> str:
    return f"{table[key]:.1f}" if key in table else "-"


def table_csv(evaluation: Evaluation) -> str:
    """One row a cell: classifier, representation, auc, P3's, and that of each group."""
    paper, groups = printed_table(), evaluation.groups
    by_group = [measured_table(evaluation, group) for group in groups]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["classifier", "representation", "auc", "paper", *groups])
    for key, value in measured_table(evaluation).items():
        own = [f"{table[key]:.2f}" if key in table else "" for table in by_group]
        writer.writerow([*key, f"{value:.2f}", paper.get(key, ""), *own])
    return file.getvalue()


def table_html(evaluation: Evaluation) -> str:
    """A page: the table of a run, one of each group, the best in bold, P3's values small."""
    paper = printed_table()
    tables = {"all": measured_table(evaluation)}
    tables |= {group: measured_table(evaluation, group) for group in evaluation.groups}
    halves = {
        f"{title}, {half}": half_table(table, paper, columns)
        for title, table in tables.items()
        for half, columns in HALVES.items()
    }
    values = {
        "heading": _heading(evaluation),
        "halves": {title: half for title, half in halves.items() if half.names},
        "note": letter_note(evaluation),
        "ranks": list(rank_correlations(tables["all"], paper)),
    }
    return page_text("table3.html", "", values)
