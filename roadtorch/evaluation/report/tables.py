"""The tables of a run: of detectors, of one detector's groups and conditions, of differences."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, get_args

from roadtorch.evaluation.measure import Figures, Measure, Place
from roadtorch.evaluation.measures import F_MASK, MAXF
from roadtorch.evaluation.report.table import (
    NONE,
    Cell,
    Table,
    number_cell,
    share,
    signed,
)
from roadtorch.evaluation.result import Difference, Evaluation
from roadtorch.layout.classes import NAMES

WORST = (F_MASK, MAXF)
"""Of many groups, the worst by these measures has a column on the screen."""

MAX_SHOWN = 40
"""Detectors on the screen besides the baselines, and rows of the page's tables by group; a grid
of 310 fills neither well."""

MAX_COLUMNS = {"screen": 6, "scores": 8}
"""Groups with a column of their own, on the screen and on the page."""


Kind = Literal["group", "condition"]

Parts = Mapping[str, Mapping[str, Figures]]
"""The figures of all detectors, by group or condition."""

# --- all detectors ----------------------------------------------------------------------


def scores(evaluation: Evaluation, names: Sequence[str], place: Place) -> Table:
    """What a user gets beside MaxF, its interval, and the figures of a place; MaxF by group.

    Of more groups than have columns the screen tells the worst, and it tells MaxF of all pooled;
    the page tells how far above the best baseline MaxF is.
    """
    detectors, groups = evaluation.detectors, evaluation.groups
    table = Table(names, baselines(evaluation))
    many = len(groups) > MAX_COLUMNS[place]
    parts = {name: detectors[name].headline for name in names}
    for group in [] if many else groups:
        table.measure(MAXF, [detectors[name].group(group) for name in names], f"MaxF\n{group}")
    for measure in evaluation.shown_in("headline"):
        table.measure(measure, parts.values())
    intervals = (detectors[name].interval for name in names)
    table.add("95 %", "Bootstrap interval of MaxF over pictures.", (
        Cell(f"{share(ends.low)}–{share(ends.high)}", ends.low) if ends.is_known else Cell(NONE)
        for ends in intervals
    ))  # fmt: skip
    if place == "scores":
        table.add(*_above_baseline(evaluation, parts))
    for measure in WORST if many and place == "screen" else ():
        cells = []
        for known in (measure.known(detectors[name].groups) for name in names):
            group = min(known, key=known.__getitem__, default=None)
            text = NONE if group is None else f"{measure.text(known[group], NONE)} {group}"
            cells.append(Cell(text, None if group is None else known[group]))
        table.add(f"worst\n{measure.name}", "The lowest of the groups, and whose it is.", cells)
    if place == "screen" and groups:
        pooled = [detectors[name].pooled for name in names]
        table.measure(MAXF, pooled, "pooled")
    for measure in evaluation.shown_in(place):
        table.measure(measure, parts.values())
    return table


def _above_baseline(
    evaluation: Evaluation, parts: Mapping[str, Figures]
) -> tuple[str, str, list[Cell]]:
    """MaxF less that of the best baseline among the same rows."""
    baseline = best_baseline(evaluation, parts)
    above = [MAXF.of(figures) - baseline[1] for figures in parts.values()]
    hint = "MaxF minus that of the best blind baseline, which never looks at the picture."
    return "above\nbaseline", hint, [number_cell(signed(value), value) for value in above]


def baselines(evaluation: Evaluation) -> set[str]:
    """The detectors that never look at the picture."""
    return {name for name, figures in evaluation.detectors.items() if figures.is_baseline}


def best_baseline(evaluation: Evaluation, parts: Mapping[str, Figures]) -> tuple[str, float]:
    """The baseline with the highest MaxF of some figures by detector; ("", NaN) without any."""
    blind = baselines(evaluation)
    scores = MAXF.known({name: figures for name, figures in parts.items() if name in blind})
    return max(scores.items(), key=lambda pair: pair[1]) if scores else ("", math.nan)


def measured(
    evaluation: Evaluation, parts: Mapping[str, Figures], *places: Place, above: bool = False
) -> Table:
    """The measures of some places; parts: figures by detector. above: MaxF over the baselines'."""
    table = Table(list(parts), baselines(evaluation))
    for measure in evaluation.shown_in("headline") if above else ():
        table.measure(measure, parts.values())
    if above:
        table.add(*_above_baseline(evaluation, parts))
    for measure in evaluation.shown_in(*places):
        table.measure(measure, parts.values())
    return table


def trust(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """How well trust tells good masks from bad ones, of the detectors that have it."""
    keys = {measure.key for measure in evaluation.shown_in("trust")}
    figures = {name: evaluation.detectors[name].headline for name in names}
    with_trust = {name: part for name, part in figures.items() if keys & part.keys()}
    return measured(evaluation, with_trust, "trust")


def differences(evaluation: Evaluation, names: Sequence[str], place: Place) -> Table:
    """Differences with intervals, strong where the interval leaves out 0."""
    changes = evaluation.comparison.differences
    table = Table([name for name in names if name in changes], baselines(evaluation))
    hint = "Difference on the same pictures, 95 % interval; bold where that leaves out 0."
    for measure in evaluation.shown_in(place):
        of_measure = [changes[name].get(measure.key) for name in table.names]
        if any(of_measure):
            under = measure.key.rpartition("/")[0].replace("/", ", ") if place == "pairs" else ""
            header = f"{under},\n{measure.name}" if under else measure.name
            table.add(header, hint, [_change(change) for change in of_measure])
    return table


def _change(change: Difference | None) -> Cell:
    if change is None:
        return Cell(NONE)
    low, high = change.interval
    if not change.interval.is_known:
        return number_cell(signed(change.value), change.value)
    note = f"{signed(low)} to {signed(high)}"
    return number_cell(signed(change.value), change.value, low > 0 or high < 0, note)


# --- groups and conditions of one detector ----------------------------------------------


def part_table(evaluation: Evaluation, name: str, kind: Kind, most: int | None = None) -> Table:
    """One detector's groups or conditions by F of its mask, the lowest first; empty without any.

    Below the groups stand their mean and those left out; behind a condition the number of its
    groups. The measures are in columns, the worst value of each strong, and the best baseline's
    MaxF. most: of the groups that count, or of the conditions, so many at most.
    """
    parts, beside = _groups(evaluation) if kind == "group" else _conditions(evaluation)
    if kind == "group" and not evaluation.detectors[name].groups:
        return Table([])
    known = F_MASK.known({label: figures[name] for label, figures in parts.items()})
    worst_first = sorted(parts, key=lambda label: known.get(label, math.inf))[:most]
    rows = {**{label: parts[label] for label in worst_first}, **beside} if parts else {}
    table = Table(list(rows))
    for measure in evaluation.shown_in("parts"):
        if any(measure.key in figures[name] for figures in rows.values()):
            values = [measure.of(figures[name]) for figures in rows.values()]
            worst = measure.worst(values[: len(worst_first)]) if len(worst_first) > 1 else None
            table.add(measure.name, measure.meaning, (
                number_cell(
                    measure.text(value, NONE), value, row < len(worst_first) and value == worst
                )
                for row, value in enumerate(values)
            ))  # fmt: skip
    best = [best_baseline(evaluation, figures)[1] for figures in rows.values()]
    cells = [number_cell(share(value), value) for value in best]
    table.add("MaxF of\nbaseline", "MaxF of the best blind baseline there.", cells)
    return table


def _groups(evaluation: Evaluation) -> tuple[Parts, Parts]:
    """The groups that count; what stands below them."""
    left_out = {f"{group} (left out)": evaluation.of_group(group) for group in evaluation.left_out}
    counting = {group: evaluation.of_group(group) for group in evaluation.groups}
    return counting, {"mean": evaluation.headlines, **left_out}


def _conditions(evaluation: Evaluation) -> tuple[Parts, Parts]:
    """The conditions with the number of their groups, and nothing below them."""
    items, parts = evaluation.dataset.by_condition(), {}
    for condition in evaluation.conditions:
        groups = len({item.group for item in items[condition]} - {None})
        of = f" ({groups} group{'' if groups == 1 else 's'})" if groups else ""
        parts[condition + of] = {
            name: figures.conditions.get(condition, {})
            for name, figures in evaluation.detectors.items()
        }
    return parts, {}


# --- layout -----------------------------------------------------------------------------


class LayoutTables(NamedTuple):
    """The layout figures of some detectors: confusion as rows of shares, and recalls."""

    names: list[str]
    confusion: list[tuple[str, list[Cell]]]
    recalls: Table


def layouts(evaluation: Evaluation, names: Sequence[str]) -> list[LayoutTables]:
    """Confusion and recalls of the detectors that label the layout; they may share one."""
    layouts_so_far: list[LayoutTables] = []
    for name in names:
        figures = evaluation.detectors[name]
        parts = {**figures.groups, "mean" if figures.groups else "all": figures.headline}
        table = Table(list(parts))
        add_recalls(table, evaluation, parts.values())
        tables = (_confusion(figures.headline), table)
        twins = [old.names for old in layouts_so_far if old[1:] == tables]
        if twins:
            twins[0].append(name)
        elif table.headers:
            layouts_so_far.append(LayoutTables([name], *tables))
    return layouts_so_far


def add_recalls(table: Table, evaluation: Evaluation, parts: Iterable[Figures]) -> None:
    """Columns of the recalls of some parts, none of them better; no column where none has any."""
    rows = list(parts)
    for measure in evaluation.shown_in("layout"):
        table.measure(measure, rows, strong=lambda _: None)


def _confusion(figures: Figures) -> list[tuple[str, list[Cell]]]:
    """Rows truth, columns decision; empty where there is none."""
    shares = {
        truth: [figures.get(f"layout/confusion/{truth}/{decided}", math.nan) for decided in NAMES]
        for truth in NAMES
    }
    if all(math.isnan(value) for row in shares.values() for value in row):
        return []
    return [
        (truth, [number_cell(share(value), value) for value in row])
        for truth, row in shares.items()
    ]


# --- the page ---------------------------------------------------------------------------


def page_tables(evaluation: Evaluation, in_charts: Sequence[str]) -> dict[str, Any]:
    """The tables of the page by name; in_charts: detectors that are told more of."""
    detectors, names = evaluation.detectors, evaluation.ranked()
    shown = names if len(names) <= MAX_SHOWN else in_charts
    of_groups = {
        group: {name: detectors[name].group(group) for name in shown}
        for group in (*evaluation.groups, *evaluation.left_out)
    }
    if any(detectors[name].pooled for name in shown):
        of_groups["all groups, pixels pooled"] = {name: detectors[name].pooled for name in shown}
    looked_at = [name for name in in_charts if not detectors[name].is_baseline]
    by = {
        kind: {
            name: table for name in looked_at if (table := part_table(evaluation, name, kind)).names
        }
        for kind in get_args(Kind)
    }
    return {
        "scores": scores(evaluation, names, "scores"),
        "further": measured(
            evaluation, {name: detectors[name].headline for name in names}, "further"
        ),
        "trust": trust(evaluation, names),
        "differences": differences(evaluation, names, "pairs"),
        "layouts": layouts(evaluation, in_charts),
        "groups": {
            group: measured(evaluation, part, "scores", "further", above=True)
            for group, part in of_groups.items()
        },
        "by": by,
        "shown": len(shown),
    }


def measures_shown(evaluation: Evaluation) -> list[Measure]:
    """The measures that the tables have, for the key to them; of equal meanings the first."""
    every = [
        figures
        for detector in evaluation.detectors.values()
        for figures in (detector.headline, detector.pooled, *detector.groups.values())
    ]
    by_meaning: dict[str, Measure] = {}
    for measure in evaluation.shown_in("headline", "scores", "further", "parts", "trust"):
        if any(measure.key in figures for figures in every):
            by_meaning.setdefault(measure.meaning, measure)
    return list(by_meaning.values())
