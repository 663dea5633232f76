"""Docstrings of this project for Sphinx: Google style, made safe for reStructuredText.

Docstrings are written to be read as they stand: paragraphs, code in double backticks, indented
blocks, |x| for a length, sections ``Args:``, ``Returns:``, ``Raises:``, ``Example:``. A paragraph
becomes one line, in which only the code is marked up; an indented block and a session (``>>>``)
become code; sections become field lists. Settings show no signature: it would be a page of types,
and the settings reference has every field with its range and meaning.
"""

import inspect
import re
from collections.abc import Iterator, Sequence
from typing import Any

from sphinx.application import Sphinx

from roadtorch.base.settings import Settings

BULLET = re.compile(r"[-*] |\d+\. ")
CODE = re.compile(r"(``.+?``)")
MARKUP = re.compile(r"([\\*|_`])")
ENTRY = re.compile(r"\*{0,2}(\w[\w., ]*?): +(?=\S)")

FIELDS = {"Args": "param", "Attributes": "ivar", "Raises": "raises"}
"""Sections with an entry for each name, and the field of Sphinx that each entry becomes."""

TEXTS = {"Returns": "returns", "Yields": "yields"}
"""Sections that are a text."""


def as_restructured(lines: Sequence[str]) -> list[str]:
    """Return a docstring as reStructuredText that shows the same."""
    made: list[str] = []
    for block in "\n".join(lines).strip("\n").split("\n\n"):
        rows = [row for row in block.split("\n") if row.strip()]
        if not rows:
            continue
        title, body = rows[0].removesuffix(":"), inspect.cleandoc("\n" + "\n".join(rows[1:]))
        if rows[0] in {"Example:", "Examples:"}:
            made += [rows[0], "", *as_restructured(body.split("\n"))]
        elif rows[0].endswith(":") and title in {*FIELDS, *TEXTS}:
            made += [*section(title, body.split("\n")), ""]
        elif rows[0].startswith((" ", ">>>")):
            made += ["::", "", *(f"    {row}" for row in rows), ""]
        else:
            made += [*paragraph(rows), ""]
    return made


def section(title: str, rows: list[str]) -> Iterator[str]:
    """Yield the field list of a section, whose rows are not indented."""
    if title in TEXTS:
        yield f":{TEXTS[title]}: {joined(rows)}"
        return
    entries: list[list[str]] = []
    for row in rows:
        if row.startswith(" ") and entries:
            entries[-1].append(row)
        else:
            entries.append([row])
    for entry in entries:
        text = " ".join(row.strip() for row in entry)
        if name := ENTRY.match(text):
            for each in name[1].split(", "):
                yield f":{FIELDS[title]} {each}: {plain(text[name.end() :])}"
        else:  # of another package
            yield from (plain(text), "")


def paragraph(rows: list[str]) -> list[str]:
    """Return a paragraph on one line; of a list, a line for each of its points."""
    if not BULLET.match(rows[0]):
        return [joined(rows)]
    points: list[str] = []
    for row in rows:
        if BULLET.match(row):
            points.append(row.strip())
        else:
            points[-1] += f" {row.strip()}"
    return [point[:2] + plain(point[2:]) for point in points]


def joined(rows: list[str]) -> str:
    """Return rows as one line of text."""
    return plain(" ".join(row.strip() for row in rows))


def plain(text: str) -> str:
    """Escape text, of which only code in double backticks is marked up."""
    parts = CODE.split(text)
    return "".join(p if CODE.fullmatch(p) else MARKUP.sub(r"\\\1", p) for p in parts)


def process_docstring(
    app: Sphinx, kind: str, name: str, member: Any, options: Any, lines: list[str]
) -> None:
    """Change the lines of a docstring in place (event ``autodoc-process-docstring``)."""
    lines[:] = as_restructured(lines)


def process_signature(
    app: Sphinx, kind: str, name: str, member: Any, options: Any, signature: str, returns: str
) -> tuple[str, None] | None:
    """Remove the signature of settings (event ``autodoc-process-signature``)."""
    return ("", None) if inspect.isclass(member) and issubclass(member, Settings) else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to the events of autodoc."""
    app.connect("autodoc-process-docstring", process_docstring)
    app.connect("autodoc-process-signature", process_signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
