"""The tables of a run: the same on the screen, in tables.md and on the page."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal, get_args

from roadtorch.evaluation.measure import Figures
from roadtorch.evaluation.measures import F_MASK, MAXF
from roadtorch.evaluation.report.table import NONE, Cell, Table, share, signed
from roadtorch.evaluation.result import Difference, Evaluation

MAX_SHOWN = 40
"""Detectors beside the baselines; a grid of 310 fills neither a screen nor a page well."""

MAX_COLUMNS = 6
"""Groups with a column of their own."""

MAX_DETAILED = 3
"""Detectors with a table by group and one by condition, the best."""

MAX_ROWS = 20
"""Rows of such a table on the screen."""

Kind = Literal["group", "condition"]


def screen(evaluation: Evaluation) -> str:
    """Return the tables of a run as text."""
    texts = [table.text() for table in run_tables(evaluation, MAX_ROWS)]
    if more := len(evaluation.detectors) - len(shortlist(evaluation)):
        texts.append(f"{more} more detectors, with lower MaxF, are in metrics.json (--out DIR)")
    return "\n\n".join(texts)


def run_tables(evaluation: Evaluation, most: int | None = None) -> list[Table]:
    """Return the tables: road, then what there is of groups, conditions, trust, layout, pairs.

    most: rows of a table by group or condition; then groups that are columns have no rows.
    """
    shown = shortlist(evaluation)
    ranked = [name for name in evaluation.ranked() if name in shown]
    best = [name for name in ranked if not evaluation.detectors[name].is_baseline][:MAX_DETAILED]
    has_columns = len(evaluation.groups) <= MAX_COLUMNS and not evaluation.left_out
    tables = [
        score_table(evaluation, ranked),
        *(
            part_table(evaluation, name, kind, most)
            for kind in get_args(Kind)
            for name in best
            if most is None or kind == "condition" or not has_columns
        ),
        trust_table(evaluation, ranked),
        layout_table(evaluation, shown),
        difference_table(evaluation, shown),
    ]
    return [table for table in tables if table.names]


def shortlist(evaluation: Evaluation) -> list[str]:
    """Return the baselines and the best of the others by MaxF, in the order of the run."""
    detectors = evaluation.detectors
    best = [name for name in evaluation.ranked() if not detectors[name].is_baseline][:MAX_SHOWN]
    return [name for name, figures in detectors.items() if figures.is_baseline or name in best]


def baselines(evaluation: Evaluation) -> set[str]:
    """Return the detectors that never look at the image."""
    return {name for name, figures in evaluation.detectors.items() if figures.is_baseline}


def score_table(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """Return the scores of detectors: MaxF of a few groups, or the worst of many, then the means.

    With groups there is also MaxF of all pixels pooled.
    """
    detectors, groups = evaluation.detectors, evaluation.groups
    table = Table("detector", names, baselines(evaluation))
    has_columns = len(groups) <= MAX_COLUMNS
    parts = [detectors[name].headline for name in names]
    for group in groups if has_columns else ():
        table.measure(MAXF, [detectors[name].group(group) for name in names], f"MaxF {group}")
    for measure in evaluation.shown_in("headline"):
        table.measure(measure, parts)
    intervals = (detectors[name].interval for name in names)
    table.add("95 %", (
        Cell(f"{share(ends.low)}–{share(ends.high)}" if ends.is_known else NONE)
        for ends in intervals
    ))  # fmt: skip
    for measure in () if has_columns else (F_MASK, MAXF):
        cells = []
        for values in (measure.known(detectors[name].groups) for name in names):
            group = min(values, key=values.__getitem__, default=None)
            text = NONE if group is None else f"{measure.text(values[group], NONE)} {group}"
            cells.append(Cell(text))
        table.add(f"worst {measure.name}", cells)
    if groups:
        table.measure(MAXF, [detectors[name].pooled for name in names], "pooled")
    for measure in evaluation.shown_in("scores"):
        table.measure(measure, parts)
    return table


def trust_table(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """Return how well trust tells good masks from bad ones, of the detectors that have it."""
    measures = evaluation.shown_in("trust")
    parts = {name: evaluation.detectors[name].headline for name in names}
    keys = {measure.key for measure in measures}
    parts = {name: figures for name, figures in parts.items() if keys & figures.keys()}
    table = Table("trust", list(parts))
    for measure in measures:
        table.measure(measure, parts.values())
    return table


def layout_table(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """Return class recalls of the detectors that label the layout, by group."""
    measures = evaluation.shown_in("layout")
    keys = {measure.key for measure in measures}
    rows = {
        (name, group): figures
        for name in names
        for detector in [evaluation.detectors[name]]
        for group, figures in (*sorted(detector.groups.items()), ("mean", detector.headline))
        if keys & figures.keys()
    }
    table = Table("layout", [name for name, _ in rows])
    table.add("group", [Cell(group) for _, group in rows])
    for measure in measures:
        table.measure(measure, rows.values(), is_ranked=False)
    return table


def difference_table(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """Return differences to one detector with intervals, strong where these leave out 0."""
    comparison = evaluation.comparison
    names = [name for name in names if name in comparison.differences]
    table = Table(f"minus {comparison.against}", names, baselines(evaluation))
    for measure in evaluation.shown_in("pairs"):
        changes = [comparison.differences[name].get(measure.key) for name in names]
        if any(changes):
            table.add(measure.name, map(_difference_cell, changes))
    return table


def _difference_cell(change: Difference | None) -> Cell:
    if change is None:
        return Cell(NONE)
    low, high = change.interval
    note = f"{signed(low)} to {signed(high)}" if change.interval.is_known else ""
    return Cell(signed(change.value), low > 0 or high < 0, note)


# --- groups and conditions of one detector ----------------------------------------------


def part_table(evaluation: Evaluation, name: str, kind: Kind, most: int | None = None) -> Table:
    """Return one detector's groups or conditions by F of its mask, the lowest first.

    Below the groups stand their mean and those left out; behind a condition the number of its
    groups. The last column is the best baseline's MaxF. most: of the groups that count, or of the
    conditions, so many at most.
    """
    parts = _groups(evaluation) if kind == "group" else _conditions(evaluation)
    known = F_MASK.known({label: figures[name] for label, figures in parts.items()})
    worst_first = sorted(parts, key=lambda label: known.get(label, math.inf))[:most]
    rows = {label: parts[label] for label in worst_first}
    if kind == "group" and rows:
        rows["mean"] = evaluation.headlines
        rows |= {f"{group} (left out)": evaluation.of_group(group) for group in evaluation.left_out}
    table = Table(f"{name} by {kind}", list(rows), omitted=len(parts) - len(worst_first))
    for measure in evaluation.shown_in("parts"):
        table.measure(measure, [figures[name] for figures in rows.values()], is_ranked=False)
    levels = (best_baseline(evaluation, figures) for figures in rows.values())
    table.add("MaxF of baseline", (Cell(share(level)) for level in levels))
    return table


def best_baseline(evaluation: Evaluation, parts: Mapping[str, Figures]) -> float:
    """Return the highest MaxF of the baselines, of some figures by detector; NaN without any."""
    scores = MAXF.known({name: parts[name] for name in baselines(evaluation) if name in parts})
    return max(scores.values(), default=math.nan)


Parts = Mapping[str, Mapping[str, Figures]]
"""The figures of all detectors, by group or condition."""


def _groups(evaluation: Evaluation) -> Parts:
    return {group: evaluation.of_group(group) for group in evaluation.groups}


def _conditions(evaluation: Evaluation) -> Parts:
    """Return the figures of each condition, by its name with the number of its groups."""
    items, parts = evaluation.dataset.by_condition(), {}
    for condition in evaluation.conditions:
        groups = len({item.group for item in items[condition]} - {None})
        of = f" ({groups} group{'' if groups == 1 else 's'})" if groups else ""
        parts[condition + of] = {
            name: figures.conditions.get(condition, {})
            for name, figures in evaluation.detectors.items()
        }
    return parts
