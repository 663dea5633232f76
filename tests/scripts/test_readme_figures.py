"""README and docs: every bound figure is as its record has it."""

import json
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from scripts import readme_figures
from scripts.readme_figures import rewrite, unbound_numbers, weights_of

ROOT = Path(__file__).resolve().parents[2]
RECORDS = sorted(readme_figures.FIGURES.glob("*.json"))


def test_every_figure_is_as_recorded_and_every_number_is_bound() -> None:
    assert readme_figures.main(["check"]) == 0


def test_no_record_is_kept_that_no_document_uses() -> None:
    unused = readme_figures.records().keys() - readme_figures.used()
    assert [name for name in unused if not name.startswith("facts.")] == []


def pages_untold(run: str, record: Mapping[str, Any]) -> list[str]:
    """List the pages with records of other weights than today's that do not name their commit."""
    if record["weights"] == weights_of(run, " ".join((record["command"], *record["values"]))):
        return []
    pages = {path.name: path.read_text("utf-8") for path in readme_figures.documents()}
    uses = {name for name, page in pages.items() if re.search(rf"[ \[?]{run}\.", page)}
    return [name for name in uses if record["commit"] not in pages[name]]


@pytest.mark.parametrize("path", RECORDS, ids=lambda path: path.stem)
def test_records_are_of_todays_weights_or_their_page_names_the_commit(path: Path) -> None:
    record = json.loads(path.read_text("utf-8"))

    assert pages_untold(path.stem, record) == []
    if path.stem == "idd-slow":
        record["weights"]["fusion"] = "0" * 8
        assert pages_untold(path.stem, record) == ["tables.md"]


def test_pages_name_commits_of_the_history_and_their_dates() -> None:
    log = ["git", "log", "--all", "--format=%h %cs", "--abbrev=7"]
    done = subprocess.run(log, cwd=ROOT, capture_output=True, text=True, check=False)
    history = dict(line.split(" ") for line in done.stdout.splitlines())
    if len(history) < 100:
        pytest.skip("the history is not here")
    for path in readme_figures.documents():
        page = path.read_text("utf-8")
        measured = readme_figures.STUDIES.get(path.relative_to(ROOT).as_posix(), {})
        assert measured.keys() <= set(re.findall(r"^#+ (.*)$", page, re.M))
        page += "\n".join(measured.values())
        assert set(readme_figures.STUDY.findall(page)) <= history.items()
        assert set(re.findall(r"\b(?:at|by|of|to|in) ([0-9a-f]{7})\b", page)) <= history.keys()
    commits = re.findall(r'"commit": "(\w+)"', "".join(map(Path.read_text, RECORDS)))
    assert set(commits) <= history.keys()


@pytest.mark.parametrize(
    ("page", "numbers"),
    [
        ("F is .9 here, and 5 % is lost in 3 ms.", [".9", "5 %", "3 ms"]),
        ("F is .9<!-- figure: many.f --> here, 5 %<!-- figure: lost --> lost.", []),
        ("Python 3.11, 3.12 or 3.13, arXiv 1412.3506, eq. 2.1, 127.0.0.1: 4 classes, `.5`", []),
        ("A formula, $x = .5$, and code:\n\n```\nF .5\n```\n", []),
        ("It rose by .1 (at 1234567, 2026-01-02).\n\nIt fell by .2.", [".2"]),
        ("- It rose by .1 (at 1234567, 2026-01-02).\n- It fell by .2.", [".2"]),
        ("# Study\n\n## Part\n\nF .1", []),
        ("# Page\n\n## Study\n\n.1\n\n## Two\n\n.2", [".2"]),
        ("<!-- table: unbound -->\n| F |\n| --- |\n| a | .3 |\n", [".3"]),
    ],
)
def test_a_number_is_bound_of_a_study_or_alone(page: str, numbers: list[str]) -> None:
    assert unbound_numbers(page, ["Study"]) == numbers


def test_figures_and_tables_are_written_from_records() -> None:
    values = {"many.f": 0.82708, "many.f.low": 0.8, "many.f.high": 0.84, "b.f": 0.9, "w": "ycor"}
    old = """F .5<!-- figure: many.f -->, worst `x`<!-- figure: w -->
<!-- table by {row}.f: [[{row}.f|0.00]] | [[?{row}.g]] | [[many.f{at}|ci]] -->
| name | F | G | all |
| --- | --- | --- | --- |
| `many`, of cameras | .1 | – | .0 |
| B<!-- row: b@low --> | .2 | – | .0 |
<!-- end -->"""
    rows = """| B<!-- row: b@low --> | 0.90 | – | .800 (.700–.900) |
| `many`, of cameras | 0.83 | – | .827 (.800–.840) |
<!-- end -->"""
    at_low = {"many.f@low": 0.8, "many.f@low.low": 0.7, "many.f@low.high": 0.9}

    new = rewrite(old, values | at_low)

    first, *header = old.splitlines()[:4]
    first = first.replace(".5", ".8").replace("`x`", "`ycor`")
    assert new == "\n".join([first, *header, rows])
    with pytest.raises(KeyError, match="gone"):
        rewrite(".5<!-- figure: gone -->", values)
