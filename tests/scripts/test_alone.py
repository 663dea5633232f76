"""Scripts are started by their paths: what lies beside them has to be found."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "scripts"
STARTED = [path for path in sorted(FOLDER.glob("*.py")) if "__main__" in path.read_text("utf-8")]


def in_order(path: Path) -> Iterator[str]:
    """``beside`` for an import from scripts at the top of a file, ``path`` for a longer path."""
    for statement in ast.parse(path.read_text("utf-8")).body:
        if isinstance(statement, ast.ImportFrom) and (statement.module or "").startswith("scripts"):
            yield "beside"
        elif isinstance(statement, ast.Expr) and "sys.path.insert" in ast.unparse(statement):
            yield "path"


@pytest.mark.parametrize("path", STARTED, ids=lambda path: path.stem)
def test_a_script_finds_those_beside_it(path: Path) -> None:
    assert next(in_order(path), "path") == "path"
