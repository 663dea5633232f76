"""The tutorials are executed, and what they print is what their pages say."""

import subprocess
import sys
from pathlib import Path

import pytest

from scripts.tutorials import commands_of, output_as_shown, same, same_line
from tests.docs.conftest import ROOT, TUTORIALS


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_page_says_what_happens(checked: str, page: Path) -> None:
    as_written = f"{page.name}: as written, "

    assert any(line.startswith(as_written) for line in checked.splitlines()), checked


def test_every_page_has_something_to_execute() -> None:
    assert len(TUTORIALS) >= 7
    for page in TUTORIALS:
        assert "```console\n$ roadtorch " in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("expected", "found"),
    [
        ("6 done; results in roads", "6 done; results in roads"),
        ("mean 0.924  0.858", "mean   0.925 0.857"),
        ("error 0.2943, 8 samples in 1 s", "error 0.2950, 8 samples in 27 s"),
        ("115,200 pixels", "115,300 pixels"),
        ("config.toml …", "config.toml and anything else"),
    ],
)
def test_lines_that_are_the_same(expected: str, found: str) -> None:
    assert same_line(expected, found)


@pytest.mark.parametrize(
    ("expected", "found"),
    [
        ("6 done", "5 done"),
        ("mean 0.924", "mean 0.824"),
        ("mean 0.924", "mean -0.924"),
        ("115,200 pixels", "99,000 pixels"),
        ("roads", "road"),
        ("config.toml …", "index.csv and anything else"),
    ],
)
def test_lines_that_are_not(expected: str, found: str) -> None:
    assert not same_line(expected, found)


def test_an_ellipsis_is_any_lines_and_nothing_else_is() -> None:
    assert same(["a", "…", "d"], ["a", "b", "c", "d"])
    assert same(["a", "…"], ["a"])
    assert not same(["a", "…", "d"], ["a", "b", "c"])
    assert not same(["a"], ["a", "b"])
    assert not same(["a", "b"], ["a"])


def test_commands_go_on_behind_a_backslash() -> None:
    text = "$ one \\\n    two\nsaid\n$ three\n"

    assert list(commands_of(text)) == [("one \\\n    two", ["said"]), ("three", [])]


def test_what_is_the_same_stays_as_it_was_written() -> None:
    assert output_as_shown(["took 3 s"], ["took 5 s"]) == "took 3 s\n"
    assert output_as_shown(["took 3 m"], ["took 5 m"]) == "took 5 m\n"


def test_what_was_left_out_of_a_line_stays_out_where_its_numbers_change() -> None:
    expected, found = ["name  F  …", "fusion  0.9  …"], ["name  F   ms", "fusion  0.4  23.1"]

    assert output_as_shown(expected, found) == "name  F  …\nfusion  0.4  …\n"


def test_a_page_with_a_planted_fault_comes_back_mended() -> None:
    page = "```console\n$ echo 3 roads\n4 roads\n```\n"
    page += "```python\nx = 1\nprint(x)\n```\n```text\n2\n```\n"
    right = page.replace("4 roads", "3 roads").replace("text\n2", "text\n1")

    code = "import sys; from scripts.tutorials import run_page; "
    code += "print(run_page(sys.stdin.read(), 'page'), end='')"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, input=page, cwd=ROOT, capture_output=True, text=True, check=True)

    assert done.stdout == right
