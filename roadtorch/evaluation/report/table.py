"""One table, two renderers: text for a screen, and cells for a page; and how pages are written."""

import base64
import hashlib
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jinja2
from tabulate import tabulate

from roadtorch.base.version import __version__
from roadtorch.evaluation.measure import Figures, Measure

NONE = "–"

MINUS = "\N{MINUS SIGN}"


def share(value: float) -> str:
    """Three decimals."""
    return NONE if math.isnan(value) else f"{value:.3f}"


def signed(value: float) -> str:
    """Three decimals with a sign."""
    return NONE if math.isnan(value) else f"{value:+.3f}".replace("-", MINUS)


def percent(value: float) -> str:
    """Per cent with one decimal."""
    return NONE if math.isnan(value) else f"{100 * value:.1f} %"


@dataclass(frozen=True)
class Cell:
    """A cell: its text, the number to sort by, whether it stands out, and a note."""

    text: str
    value: float | None = None
    strong: bool = False
    note: str = ""  # small, below; on the screen in a column of its own


def number_cell(text: str, value: float, strong: bool = False, note: str = "") -> Cell:
    """A cell that is sorted by a number; undefined ones have none to be sorted by."""
    return Cell(text, None if math.isnan(value) else value, strong, note)


@dataclass(frozen=True)
class Table:
    """Columns under headers, each header with a line that explains it; rows by name.

    baselines: the rows that are set apart, for they never look at the picture.
    """

    names: Sequence[str]
    baselines: Collection[str] = ()
    headers: list[tuple[str, str]] = field(default_factory=list)
    columns: list[list[Cell]] = field(default_factory=list)

    def add(self, header: str, hint: str, cells: Iterable[Cell]) -> None:
        """One more column."""
        self.headers.append((header, hint))
        self.columns.append(list(cells))

    def measure(
        self,
        measure: Measure,
        parts: Iterable[Figures],
        header: str = "",
        strong: Callable[[Sequence[float]], float | None] | None = None,
    ) -> None:
        """A column of one measure; none if nobody has the measure.

        strong: which of the values stands out, the best if not given.
        """
        rows = list(parts)
        if any(measure.key in figures for figures in rows):
            values = [measure.of(figures) for figures in rows]
            alone = sum(not math.isnan(value) for value in values) < 2
            chosen = None if alone else (strong or measure.best)(values)
            cells = (
                number_cell(measure.text(value, NONE), value, value == chosen) for value in values
            )
            self.add(header or measure.name, measure.meaning, cells)

    def rows(self) -> list[tuple[str, list[Cell]]]:
        """Name and cells of each row."""
        cells = zip(*self.columns, strict=True) if self.columns else ([] for _ in self.names)
        return [(name, list(row)) for name, row in zip(self.names, cells, strict=True)]


# --- the screen -------------------------------------------------------------------------


def table_text(table: Table, title: str) -> str:
    """The table under a title, for a screen; headers on one line; "" for one without rows.

    Notes are intervals, and have a column "95 %" of their own.
    """
    if not table.names:
        return ""
    headers, columns = [title], [list(table.names)]
    for (header, _), cells in zip(table.headers, table.columns, strict=True):
        headers.append(header.replace("\n/", "/").replace("\n", " "))
        columns.append([_plain(cell.text) for cell in cells])
        if any(cell.note for cell in cells):
            headers.append("95 %")
            columns.append([_plain(cell.note) for cell in cells])
    return aligned([headers, *zip(*columns, strict=True)])


def _plain(text: str) -> str:
    """A cell that can be searched for and copied from a screen."""
    return "-" if text == NONE else text.replace(MINUS, "-")


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows of text in columns: the first to the left, the others to the right."""
    sides = ("left", *["right"] * (len(rows[0]) - 1))
    return tabulate(rows, tablefmt="plain", disable_numparse=True, colalign=sides)


# --- pages ------------------------------------------------------------------------------


def _sha256(script: str) -> str:
    """The name by which a content security policy allows one script and no other."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


PAGES = jinja2.Environment(
    loader=jinja2.PackageLoader("roadtorch.evaluation.report", "."),
    autoescape=True,
    trim_blocks=True,
    lstrip_blocks=True,
)
PAGES.filters |= {"sha256": _sha256, "share": share, "percent": percent}


def page_text(template: str, command: str, values: Mapping[str, Any]) -> str:
    """A page from a template of this package, one file that asks for no other.

    Whatever is put in is text and only text. command: what made the page.
    """
    text = PAGES.get_template(template).render(**values, version=__version__, command=command)
    # A file name may hold bytes that are no text.
    return text.encode("utf-8", "backslashreplace").decode()
