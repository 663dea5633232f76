"""A table in three forms: text for a screen, Markdown, HTML; and pages of tables and images."""

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jinja2

from roadtorch.base.version import __version__
from roadtorch.evaluation.measure import UNDEFINED, Measure, Scores

MINUS = "\N{MINUS SIGN}"

MAX_ROW_NAME = 48  # letters of a name on a screen of limited width


def format_number(value: float) -> str:
    """Return a number with three decimals."""
    return UNDEFINED if math.isnan(value) else f"{value:.3f}"


def format_signed(value: float) -> str:
    """Return a number with three decimals and its sign."""
    return UNDEFINED if math.isnan(value) else f"{value:+.3f}".replace("-", MINUS)


def format_percent(value: float) -> str:
    """Return a fraction in per cent with one decimal."""
    return UNDEFINED if math.isnan(value) else f"{100 * value:.1f} %"


@dataclass(frozen=True)
class Cell:
    """A cell: its text, whether it is bold, and a note below it, such as an interval."""

    text: str
    strong: bool = False
    note: str = ""


@dataclass(frozen=True)
class Table:
    """Columns of cells under headers."""

    title: str  # header of the names of the rows
    names: Sequence[str]
    baselines: Collection[str] = ()  # names of rows that ignore the image
    omitted: int = 0  # number of rows that only metrics.json has
    required: Collection[str] = ()  # headers of columns that every screen shows, however narrow
    headers: list[str] = field(default_factory=list)
    columns: list[list[Cell]] = field(default_factory=list)

    def add(self, header: str, cells: Iterable[Cell]) -> None:
        """Add a column."""
        self.headers.append(header)
        self.columns.append(list(cells))

    def add_measure(
        self, measure: Measure, rows: Iterable[Scores], header: str = "", is_ranked: bool = True
    ) -> None:
        """Add a column of a measure, the best value bold; nothing if no row has the measure."""
        parts = list(rows)
        if any(measure.key in scores for scores in parts):
            values = [measure.get(scores) for scores in parts]
            is_alone = sum(not math.isnan(value) for value in values) < 2
            best = measure.best(values) if is_ranked and not is_alone else None
            cells = (Cell(measure.format(value), value == best) for value in values)
            self.add(header or measure.name, cells)

    def rows(self) -> list[tuple[str, list[Cell]]]:
        """Return name and cells of each row."""
        cells = zip(*self.columns, strict=True) if self.columns else ([] for _ in self.names)
        return [(name, list(row)) for name, row in zip(self.names, cells, strict=True)]

    def text(self, width: float = math.inf) -> str:
        """Return the table for a screen; notes, which are intervals, have their own columns.

        width: letters in a line; to fit, long names are shortened, and the last columns that are
        not required are left out.
        """
        names = [self.title, *self.names]
        if width < math.inf:
            names = [shorten(name, MAX_ROW_NAME) for name in names]
        pairs = list(zip(self.headers, self.columns, strict=True))
        optional = [pair for pair in pairs if pair[0] not in self.required]
        text = _aligned_columns(names, pairs)
        while optional and max(map(len, text.splitlines())) > width:
            pairs.remove(optional.pop())
            text = _aligned_columns(names, pairs)
        if self.omitted:
            text += f"\n{self.omitted} more rows: metrics.json (--out DIR)"
        return text

    def to_markdown(self) -> str:
        """Return the table as Markdown, notes in parentheses."""
        rows = [
            [name, *(f"{cell.text} ({cell.note})" if cell.note else cell.text for cell in cells)]
            for name, cells in self.rows()
        ]
        rule = ["---", *("---:" for _ in self.headers)]
        lines = [[self.title, *self.headers], rule, *rows]
        return "".join(f"| {' | '.join(map(_escape, cells))} |\n" for cells in lines)


def _aligned_columns(names: list[str], pairs: Sequence[tuple[str, list[Cell]]]) -> str:
    columns = [names]
    for header, cells in pairs:
        columns.append([header, *(_to_ascii(cell.text) for cell in cells)])
        if any(cell.note for cell in cells):
            columns.append(["95 %", *(_to_ascii(cell.note) for cell in cells)])
    return align_columns(list(zip(*columns, strict=True)))


def _to_ascii(text: str) -> str:
    """Replace dashes and minus signs of a cell, so that it can be searched for and copied."""
    return "-" if text == UNDEFINED else text.replace(MINUS, "-")


def _escape(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|")


def shorten(name: str, length: int) -> str:
    """Return a printable name of so many letters at most, with both of its ends."""
    text = "".join(letter if letter.isprintable() else "?" for letter in name)
    return text if len(text) <= length else f"{text[: length - 10]}…{text[-9:]}"


def align_columns(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of text in aligned columns: the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *cells in rows:
        words = (cell.rjust(width) for cell, width in zip(cells, widths[1:], strict=True))
        lines.append("  ".join([first.ljust(widths[0]), *words]).rstrip())
    return "\n".join(lines)


# --- pages ------------------------------------------------------------------------------

TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("roadtorch.evaluation.report", "."),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)

Images = Sequence[tuple[str, str]]  # captions and data URIs


class Section(NamedTuple):
    """A part of a page: a note, tables, images below one another, and charts beside one another."""

    title: str = ""
    note: str = ""
    tables: Sequence[Table] = ()
    images: Images = ()
    charts: Images = ()


def render_page(title: str, summary: str, sections: Sequence[Section], **more: object) -> str:
    """Return a self-contained page, all values escaped.

    more: verdict, use and command (command lines), failures (with image and reason), and glossary.
    """
    values = {"failures": (), "glossary": {}, "command": "", "use": "", "verdict": "", **more}
    page = {"title": title, "summary": summary, "sections": sections, "version": __version__}
    text = TEMPLATES.get_template("page.html").render(values, **page)
    # A file name may hold bytes that are no text.
    return text.encode("utf-8", "backslashreplace").decode()
