"""Docstrings of this project for Sphinx: plain sentences, made safe for reStructuredText.

Docstrings here are written to be read as they stand: paragraphs, code in double backticks,
indented blocks, |x| for a length. A paragraph becomes one line, in which only the code is marked
up; an indented block becomes code. Settings show no signature: it would be a page of types, and
the settings reference has every field with its range and meaning.
"""

import inspect
import re
from typing import Any

from sphinx.application import Sphinx

from roadtorch.base.settings import Settings

BULLET = re.compile(r"[-*] |\d+\. ")
CODE = re.compile(r"(``.+?``)")
MARKUP = re.compile(r"([\\*|_`])")


def as_restructured(lines: list[str]) -> list[str]:
    """The lines of a docstring as reStructuredText that says just what they say."""
    made: list[str] = []
    for block in "\n".join(lines).strip("\n").split("\n\n"):
        rows = [row for row in block.split("\n") if row.strip()]
        if rows and all(row.startswith(" ") for row in rows):
            made += ["::", "", *(f"    {row}" for row in rows), ""]
        elif rows:
            made += [*paragraph(rows), ""]
    return made


def paragraph(rows: list[str]) -> list[str]:
    """One paragraph on one line; of a list, a line for each of its points."""
    if not BULLET.match(rows[0]):
        return [plain(" ".join(row.strip() for row in rows))]
    points: list[str] = []
    for row in rows:
        if BULLET.match(row):
            points.append(row.strip())
        else:
            points[-1] += f" {row.strip()}"
    return [point[:2] + plain(point[2:]) for point in points]


def plain(text: str) -> str:
    """Text of which only code in double backticks is marked up."""
    parts = CODE.split(text)
    return "".join(p if CODE.fullmatch(p) else MARKUP.sub(r"\\\1", p) for p in parts)


def process_docstring(
    app: Sphinx, problem: str, name: str, found: Any, options: Any, lines: list[str]
) -> None:
    """Sphinx's event: change the lines of a docstring in place."""
    lines[:] = as_restructured(lines)


def process_signature(
    app: Sphinx, problem: str, name: str, found: Any, options: Any, signature: str, returns: str
) -> tuple[str, None] | None:
    """Sphinx's event: no signature for settings."""
    of_settings = inspect.isclass(found) and issubclass(found, Settings)
    return ("", None) if of_settings else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Listen to autodoc."""
    app.connect("autodoc-process-docstring", process_docstring)
    app.connect("autodoc-process-signature", process_signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
