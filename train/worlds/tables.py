"""The tables of this folder, *.csv, which say what the worlds are made of. Needs no Blender."""

import csv
from functools import cache
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def parse_cell(text: str) -> Any:
    """Parse a cell: ``NAME=WEIGHT …``, ``NUMBER:NUMBER…``, a number or text."""
    if "=" in text:
        pairs = (pair.partition("=") for pair in text.split())
        return {name: float(weight) for name, _, weight in pairs}
    try:
        numbers = [float(part) if "." in part else int(part) for part in text.split(":")]
    except ValueError:
        return text
    return numbers[0] if len(numbers) == 1 else tuple(numbers)


@cache
def read_table(name: str) -> tuple[Row, ...]:
    """Read the rows of a table, whose cells are parsed."""
    with (Path(__file__).parent / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return tuple({column: parse_cell(cell) for column, cell in row.items()} for row in rows)


def read_column(name: str, column: str) -> Row:
    """Return a column of a table, by its first."""
    return {next(iter(row.values())): row[column] for row in read_table(name)}
