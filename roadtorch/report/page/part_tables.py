"""Tables of one detector, a group or a condition in each row, the worst on top."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.result import Evaluation
from roadtorch.report.page.svg import Series
from roadtorch.report.page.tables import NONE, Table, number_cell, share
from roadtorch.report.parts import PartRow

Rows = Callable[[Evaluation, str], list[PartRow]]
"""The rows of the detector of that name."""


def part_tables(
    evaluation: Evaluation, series: Sequence[Series], rows_of: Rows
) -> dict[str, Table]:
    """By detector, of those in the charts that are no baselines; empty without such parts."""
    tables = {
        one.name: part_table(rows_of(evaluation, one.name), evaluation.shown_in("parts"))
        for one in series
        if not one.is_baseline
    }
    return {name: table for name, table in tables.items() if table.names}


def part_table(rows: Sequence[PartRow], measures: Sequence[Measure]) -> Table:
    """The measures in columns, the worst value of each strong, and the best baseline's MaxF."""
    table = Table([row.name for row in rows])
    for one in measures:
        if any(one.key in row.figures for row in rows):
            _add(table, one, rows)
    baselines = [number_cell(share(row.baseline), row.baseline) for row in rows]
    table.add("MaxF of\nbaseline", "MaxF of the best blind baseline there.", baselines)
    return table


def _add(table: Table, one: Measure, rows: Sequence[PartRow]) -> None:
    counting = [one.of(row.figures) for row in rows if row.counts]
    worst = opposite(one).best(counting) if len(counting) > 1 else None
    table.add(
        one.name,
        one.meaning,
        [
            number_cell(one.text(value, NONE), value, row.counts and value == worst)
            for row in rows
            for value in [one.of(row.figures)]
        ],
    )


def opposite(one: Measure) -> Measure:
    """The same measure, of which the worst value is the best."""
    turned = {"higher": "lower", "lower": "higher", None: None}
    return replace(one, better=turned[one.better])
