"""The tables of a report: the cells as text, the numbers to sort them by."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from roadtorch.evaluation.measure import Figures, Measure
from roadtorch.evaluation.measures import MAXF
from roadtorch.evaluation.result import Difference, Evaluation
from roadtorch.layout.classes import NAMES
from roadtorch.report.page.svg import Series
from roadtorch.report.parts import best_baseline

NONE = "–"

MOST_COLUMNS = 8  # groups with a column of their own

MOST_ROWS = 40  # of tables by group and of layouts; more detectors: those in the charts


def share(value: float) -> str:
    """Three decimals."""
    return NONE if math.isnan(value) else f"{value:.3f}"


def signed(value: float) -> str:
    """Three decimals with a sign."""
    return NONE if math.isnan(value) else f"{value:+.3f}".replace("-", "\N{MINUS SIGN}")


def measures_shown(evaluation: Evaluation) -> list[Measure]:
    """The measures that the tables have, for the key to them; of equal meanings the first."""
    every = [
        figures
        for one in evaluation.detectors.values()
        for figures in (one.headline, one.pooled, *one.groups.values())
    ]
    shown = {
        one.key for one in evaluation.shown_in("headline", "scores", "further", "parts", "trust")
    }
    found: dict[str, Measure] = {}
    for one in evaluation.measures:
        if one.key in shown and any(one.key in figures for figures in every):
            found.setdefault(one.meaning, one)
    return list(found.values())


# --- tables -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """A cell: its text, the number to sort by, whether it stands out, and a note."""

    text: str
    value: float | None = None
    strong: bool = False
    note: str = ""  # small, below


@dataclass(frozen=True)
class Table:
    """Columns under headers, each header with a line that explains it; rows by name."""

    names: Sequence[str]
    headers: list[tuple[str, str]] = field(default_factory=list)
    columns: list[list[Cell]] = field(default_factory=list)

    def add(self, header: str, hint: str, cells: Sequence[Cell]) -> None:
        """One more column."""
        self.headers.append((header, hint))
        self.columns.append(list(cells))

    def measure(self, one: Measure, parts: Sequence[Figures], header: str = "") -> None:
        """A column of one measure, the best in it strong; none if nobody has the measure."""
        if any(one.key in figures for figures in parts):
            values = [one.of(figures) for figures in parts]
            alone = sum(not math.isnan(value) for value in values) < 2
            best = None if alone else one.best(values)
            cells = [number_cell(one.text(value, NONE), value, value == best) for value in values]
            self.add(header or one.name, one.meaning, cells)

    def rows(self) -> list[tuple[str, list[Cell]]]:
        """Name and cells of each row."""
        cells = zip(*self.columns, strict=True) if self.columns else ([] for _ in self.names)
        return [(name, list(row)) for name, row in zip(self.names, cells, strict=True)]


def number_cell(text: str, value: float, strong: bool = False, note: str = "") -> Cell:
    """A cell that is sorted by a number; undefined ones have none to be sorted by."""
    return Cell(text, None if math.isnan(value) else value, strong, note)


def all_tables(evaluation: Evaluation, series: Sequence[Series]) -> dict[str, Any]:
    """Scores, further measures and trust of all detectors, differences, the tables by group."""
    detectors, names = evaluation.detectors, evaluation.ranked()
    shown = names if len(names) <= MOST_ROWS else [one.name for one in series]
    groups = {
        group: {name: detectors[name].group(group) for name in shown}
        for group in (*evaluation.groups, *evaluation.left_out)
    }
    if any(detectors[name].pooled for name in shown):
        groups["all groups, pixels pooled"] = {name: detectors[name].pooled for name in shown}
    return {
        "scores": scores(evaluation, names),
        "further": further(evaluation, names),
        "trust": trust(evaluation, names),
        "differences": differences(evaluation, names),
        "groups": {group: of_part(evaluation, part) for group, part in groups.items()},
        "shown": len(shown),
    }


def scores(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """MaxF by group and mean, its interval, its distance to the baseline, and the other scores."""
    detectors, table, groups = evaluation.detectors, Table(names), evaluation.groups
    parts = {name: detectors[name].headline for name in names}
    for group in groups if len(groups) <= MOST_COLUMNS else []:
        table.measure(MAXF, [detectors[name].group(group) for name in names], f"MaxF\n{group}")
    for one in evaluation.shown_in("headline"):
        header = f"{one.name}\nmean" if groups and one is MAXF else one.name
        table.measure(one, list(parts.values()), header)
    intervals = [_interval(evaluation, name) for name in names]
    table.add("95 %", "Bootstrap interval of MaxF over pictures.", intervals)
    table.add(*_above_baseline(evaluation, parts))
    for one in evaluation.shown_in("scores"):
        table.measure(one, list(parts.values()))
    return table


def of_part(evaluation: Evaluation, part: Mapping[str, Figures]) -> Table:
    """All figures of one group, or of a set whose groups are pooled, by detector."""
    table = Table(list(part))
    for one in evaluation.shown_in("headline"):
        table.measure(one, list(part.values()))
    table.add(*_above_baseline(evaluation, part))
    for one in evaluation.shown_in("scores", "further"):
        table.measure(one, list(part.values()))
    return table


def further(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """The measures that are no scores: decisions, borders, and what is left."""
    table = Table(names)
    for one in evaluation.shown_in("further"):
        table.measure(one, [evaluation.detectors[name].headline for name in names])
    return table


def trust(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """How well trust tells good masks from bad ones, of the detectors that have it."""
    measures = evaluation.shown_in("trust")
    figures = {name: evaluation.detectors[name].headline for name in names}
    table = Table([name for name in names if any(one.key in figures[name] for one in measures)])
    for one in measures:
        table.measure(one, [figures[name] for name in table.names])
    return table


def _interval(evaluation: Evaluation, name: str) -> Cell:
    ends = evaluation.detectors[name].interval
    return Cell(f"{share(ends.low)}–{share(ends.high)}", ends.low) if ends.is_known else Cell(NONE)


def _above_baseline(
    evaluation: Evaluation, part: Mapping[str, Figures]
) -> tuple[str, str, list[Cell]]:
    """MaxF less that of the best baseline among the same rows."""
    values = {name: MAXF.of(figures) for name, figures in part.items()}
    baseline = best_baseline(evaluation, values)
    above = [value - baseline[1] if baseline else math.nan for value in values.values()]
    hint = "MaxF minus that of the best blind baseline, which never looks at the picture."
    return "above\nbaseline", hint, [number_cell(signed(value), value) for value in above]


# --- differences ------------------------------------------------------------------------


def differences(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """Differences with intervals, strong where the interval leaves out 0."""
    changes = evaluation.comparison.differences
    table = Table([name for name in names if name in changes])
    hint = "Difference on the same pictures, 95 % interval; bold where that leaves out 0."
    for one in evaluation.shown_in("pairs"):
        found = [changes[name].get(one.key) for name in table.names]
        if any(found):
            under = one.key.rpartition("/")[0].replace("/", ", ")
            header = f"{under},\n{one.name}" if under else one.name
            table.add(header, hint, [_change(change) for change in found])
    return table


def _change(change: Difference | None) -> Cell:
    if change is None:
        return Cell(NONE)
    low, high = change.interval
    if not change.interval.is_known:
        return number_cell(signed(change.value), change.value)
    note = f"{signed(low)} to {signed(high)}"
    return number_cell(signed(change.value), change.value, low > 0 or high < 0, note)


# --- layout -----------------------------------------------------------------------------


@dataclass(frozen=True)
class LayoutTables:
    """The layout figures of one detector: its confusion as rows of shares, and recalls."""

    name: str
    confusion: list[tuple[str, list[Cell]]]
    recalls: Table

    def equals(self, other: "LayoutTables") -> bool:
        """Whether both have the same figures: detectors may share one layout."""
        return replace(self, name=other.name) == other


def layouts(evaluation: Evaluation, series: Iterable[Series]) -> list[LayoutTables]:
    """Confusion and recalls of the detectors in the charts that label the layout."""
    found: list[LayoutTables] = []
    for one in series:
        recalls = _recalls(evaluation, one.name)
        if recalls.headers:
            figures = evaluation.detectors[one.name].headline
            layout = LayoutTables(one.name, _confusion(figures), recalls)
            twin = next((i for i, old in enumerate(found) if layout.equals(old)), None)
            if twin is None:
                found.append(layout)
            else:
                found[twin] = replace(found[twin], name=f"{found[twin].name}, {one.name}")
    return found


def _recalls(evaluation: Evaluation, name: str) -> Table:
    """Recalls by group and their mean, or of the whole set; without columns if there are none."""
    one = evaluation.detectors[name]
    parts = {**one.groups, "mean" if one.groups else "all": one.headline}
    table = Table(list(parts))
    for measure in evaluation.shown_in("layout"):
        table.measure(replace(measure, better=None), list(parts.values()))
    return table


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
