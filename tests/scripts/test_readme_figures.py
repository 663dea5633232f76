"""README and docs: every bound figure is as its record has it."""

import json
import re
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from roadtorch.layout.weights import list_shipped_weights, shipped_weights
from scripts import readme_figures
from scripts.readme_figures import restate, rewrite, unbound_numbers, weights_of

ROOT = Path(__file__).resolve().parents[2]
RECORDS = sorted(readme_figures.FIGURES.glob("*.json"))


def test_every_figure_is_as_recorded_and_every_number_is_bound() -> None:
    assert readme_figures.main(["check"]) == 0


def test_no_record_is_kept_that_no_document_uses() -> None:
    unused = readme_figures.records().keys() - readme_figures.used()
    assert [name for name in unused if not name.startswith("facts.")] == []


def pages_untold(run: str, record: Mapping[str, Any]) -> list[str]:
    """List the pages with records of other weights than today's that do not name their commit."""
    if record["weights"] == weights_of(" ".join((record["command"], *record["values"]))):
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


@pytest.mark.parametrize(
    ("figure", "value", "now"),
    [
        (".827", 0.8312, ".831"),
        ("+.012", -0.0041, "\N{MINUS SIGN}.004"),
        ("\N{MINUS SIGN}0.01", 0.02, "+0.02"),
        ("82.7 %", 0.8312, "83.1 %"),
        ("1,318", 55, "55"),
        ("470,000", 473557, "474,000"),
        ("12", 11.6, "12"),
        ("`dn_cat`", "dn_tas500", "`dn_tas500`"),
    ],
)
def test_a_value_is_said_as_the_old_figure_was(figure: str, value: float | str, now: str) -> None:
    assert restate(figure, value) == now


def test_the_table_of_models_has_all_weights_described_from_their_files() -> None:
    large, scores = readme_figures.describe_networks("fusion:large"), ROOT / "docs/results.md"
    bytes_ = sum(shipped_weights(name).stat().st_size for name in str(large["weights"]).split(", "))

    assert (large["bytes"], large["input"]) == (bytes_, "224×256")
    table = scores.read_text("utf-8").partition("## Models")[2].partition("<!-- end -->")[0]
    assert [name for name in list_shipped_weights() if name not in table] == []


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


def test_an_evaluation_becomes_flat_records() -> None:
    groups = {"a": {"f_mask": 0.9, "maxf": 0.95}, "b": {"f_mask": 0.7, "maxf": 0.99}}
    fusion = {"f_mask": 0.8, "maxf": 0.9, "settings": {"random_seed": 3}}
    fusion |= {"layout": {"mean": None, "sky": 0.7}, "conditions": {"night": {"f_mask": 0.5}}}
    fusion |= {"groups": groups, "ci95": {"maxf": [0.88, 0.91], "f_mask": None}}
    paired = {"detectors": {"fusion": {"maxf": {"difference": -0.4, "ci95": [-0.5, -0.3]}}}}

    metrics = {"images": 5, "detectors": {"fusion": fusion}, "paired": paired}
    records = readme_figures.records_of("run", metrics)

    expected = {"maxf": 0.9, "maxf.low": 0.88, "maxf.high": 0.91, "layout.sky": 0.7}
    expected |= {"f_mask@b": 0.7, "f_mask@night": 0.5, "f_mask.worst": 0.7, "maxf.less": -0.4}
    expected |= {"f_mask.worst.camera": "b", "maxf.worst.camera": "a", "maxf.less.high": -0.3}
    assert {name: records.get(f"run.fusion.{name}") for name in expected} == expected
    assert records["run.images"] == 5
    assert not [name for name in records if "seed" in name or "layout.mean" in name]
