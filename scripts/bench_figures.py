"""Figures of benchmarks: kept in one file, shown in the tables of a page, checked against it.

A figure is one flat record: ``name`` is ``part/row/column``, with its value, unit, quartiles,
rounds, and what made it: command, date, machine, commit. A page has the table of a part between
``<!-- bench: PART -->`` and ``<!-- end -->``; nothing there is written by hand.
"""

import json
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

Figure = dict[str, Any]
DIGITS = {"ms": 1, "s": 2, "": 2, "MiB": 0, "kernels": 0}
BLOCK = re.compile(r"(<!-- bench: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def figure(part: str, row: str, column: str, value: float | str, unit: str = "") -> Figure:
    """One figure of a part, by the row and the column that it has in the part's table."""
    rounded = value if isinstance(value, str) else float(f"{value:.4g}")
    return {"name": f"{part}/{row}/{column}", "value": rounded, "unit": unit}


def read_figures(path: Path) -> list[Figure]:
    """The figures of a file; none where there is no file."""
    return json.loads(path.read_text("utf-8")) if path.is_file() else []


def write_figures(path: Path, figures: Sequence[Figure]) -> None:
    """Write the figures, one a line, whole or not at all."""
    lines = ",\n".join(json.dumps(one, ensure_ascii=False) for one in figures)
    temporary = path.with_name(path.name + ".new")
    temporary.write_text(f"[\n{lines}\n]\n", "utf-8")
    os.replace(temporary, path)


def merged(old: Sequence[Figure], new: Sequence[Figure], remade: str) -> list[Figure]:
    """The figures with those of the command ``remade`` replaced by new ones, where they stood."""
    kept = [one for one in old if one["command"] != remade]
    known = {one["name"] for one in new}
    kept = [one for one in kept if one["name"] not in known]
    gone = [at for at, one in enumerate(old) if one["command"] == remade]
    at = gone[0] if gone else len(kept)
    return [*kept[:at], *new, *kept[at:]]


def part_table(figures: Iterable[Figure], part: str) -> str:
    """The Markdown table of a part, rows and columns in the order of their first figures."""
    cells: dict[str, dict[str, str]] = {}
    columns: dict[str, None] = {}
    own = [one for one in figures if one["name"].split("/", 2)[0] == part]
    for one in own:
        _, row, column = one["name"].split("/", 2)
        cells.setdefault(row, {})[column] = _shown(one)
        columns[column] = None
    if not own:
        return "Not measured yet."
    lines = ["| | " + " | ".join(columns) + " |", "|---|" + "---:|" * len(columns)]
    lines += [
        f"| {row} | " + " | ".join(found.get(column, "") for column in columns) + " |"
        for row, found in cells.items()
    ]
    return "\n".join([*lines, "", *_made_by(own)])


def _made_by(figures: Sequence[Figure]) -> list[str]:
    """What made a part's figures, a line a run."""
    runs = {
        (one["command"], one["rounds"], one["date"], one["machine"], one["load"]): None
        for one in figures
    }
    return [
        f"`{command}`, {f'{rounds} rounds, ' if rounds else ''}{date}, {machine}, load {load}.  "
        for command, rounds, date, machine, load in runs
    ]


def _shown(one: Figure) -> str:
    value = one["value"]
    if isinstance(value, str):
        return value
    digits = DIGITS.get(one["unit"], 1)
    return f"{value:,.{digits}f}".replace(",", " ") if value < 1e5 else f"{value:.3g}"


def written(page: str, figures: Sequence[Figure]) -> str:
    """A page with the tables of its parts as the figures say."""

    def block(found: re.Match[str]) -> str:
        return f"{found[1]}\n{part_table(figures, found[2])}\n\n{found[3]}"

    return BLOCK.sub(block, page)


def rewrite(path: Path, figures: Sequence[Figure]) -> None:
    """Put the tables into the page at this path."""
    path.write_text(written(path.read_text("utf-8"), figures), "utf-8")


def stale(page: str, figures: Sequence[Figure]) -> list[str]:
    """What a page says otherwise than the figures, a line each; none: all is as measured."""
    wanted = written(page, figures)
    said, should = page.splitlines(), wanted.splitlines()
    faults = [
        f"line {number}: {line} (measured: {other})"
        for number, (line, other) in enumerate(zip(said, should, strict=False), 1)
        if line != other
    ]
    named = set(match[2] for match in BLOCK.finditer(page))
    faults += [f"no table of {part}" for part in _parts(figures) if part not in named]
    return faults or ([] if page == wanted else ["the tables have other lengths"])


def _parts(figures: Iterable[Figure]) -> dict[str, None]:
    return {one["name"].split("/", 2)[0]: None for one in figures}


Measure = Callable[[int, int], list[Figure]]
"""Measures a part: threads and rounds → its figures."""
Parts = Mapping[str, Measure]
