"""docs/reliability.md names tests, scripts and kinds of files that are there."""

import ast
import re
from pathlib import Path

import pytest

from scripts.fuzz import KINDS

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs/reliability.md").read_text(encoding="utf-8")
NAMED = re.findall(r"([\w/]+\.py)::(\w+)", TEXT)
ROWS = re.findall(r"^\| (\d+) \|.*\| (.*) \|$", TEXT, re.MULTILINE)


def test_each_of_the_twenty_one_has_a_test() -> None:
    assert [int(number) for number, _ in ROWS] == list(range(1, 22))
    assert all("::test_" in tests for _, tests in ROWS)


@pytest.mark.parametrize(("file", "name"), NAMED)
def test_a_test_that_is_named_exists(file: str, name: str) -> None:
    tree = ast.parse((ROOT / "tests" / file).read_text(encoding="utf-8"))

    assert name in {part.name for part in tree.body if isinstance(part, ast.FunctionDef)}


def test_scripts_and_test_files_that_are_named_exist() -> None:
    for path in re.findall(r"\b(?:scripts|tests)/[\w/]+\.py", TEXT):
        assert (ROOT / path).is_file(), path


def test_every_kind_of_file_that_is_fuzzed_is_named() -> None:
    cells = re.findall(r"^\| ([a-z, ]+) \|", TEXT.split("## Figures")[0], re.MULTILINE)
    named = {kind.strip() for cell in cells for kind in cell.split(",")} - {"kind"}

    assert named == set(KINDS)
