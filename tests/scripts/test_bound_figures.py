"""Figures in documents are held against their sources; those without one are found."""

import json
from pathlib import Path

import pytest

from scripts import bound_figures
from scripts.bound_figures import Record, Table

RECORDS = {
    "many.f": Record(0.82708, "share", "roadtorch evaluate"),
    "many.worst": Record("dn_tas500", "name", "roadtorch evaluate"),
    "flicker.left": Record(0.3149, "share", "python scripts/steady.py"),
    "pairs.low": Record(-0.0041, "share", "roadtorch evaluate"),
    "pictures": Record(1318, "pictures", "the code"),
    "weights": Record(473557, "weights", "the code"),
}
SCORES = Table(
    ("detector", "F"), (("`a`", "many"), ("`b`", "flicker")), ("[[?{row}.f|.000]]",), sort=""
)
TABLES = {"scores": SCORES}
WRITTEN = "| detector | F |\n| --- | --- |\n| `a` | .827 |\n| `b` | – |\n"


@pytest.mark.parametrize(
    ("said", "value", "now"),
    [
        (".827", 0.8312, ".831"),
        ("0.82", 0.8312, "0.83"),
        ("+.012", 0.0041, "+.004"),
        ("+.012", -0.0041, "\N{MINUS SIGN}.004"),
        ("\N{MINUS SIGN}0.01", 0.02, "+0.02"),
        (".9", 1.0, "1.0"),
        ("31 %", 0.3149, "31 %"),
        ("82.7 %", 0.8312, "83.1 %"),
        ("1,318", 55, "55"),
        ("55", 1318, "1318"),
        ("470,000", 473557, "474,000"),
        ("12", 11.6, "12"),
        ("`dn_cat`", "dn_tas500", "`dn_tas500`"),
    ],
)
def test_a_value_is_said_as_the_old_figure_was(said: str, value: float | str, now: str) -> None:
    assert bound_figures.restated(said, value) == now


GOOD = """F .827<!-- figure: many.f --> and 31 %<!-- figure: flicker.left --> left, worst
`dn_tas500`<!-- figure: many.worst -->, from -.004<!-- figure: pairs.low --> on.
Of 1,318<!-- figure: pictures --> pictures.
"""


def test_what_agrees_is_not_stale_and_stays_as_it_is_written() -> None:
    assert bound_figures.stale(GOOD, RECORDS, TABLES) == []
    assert bound_figures.rewritten(GOOD, RECORDS, TABLES) == GOOD
    assert bound_figures.unbound(GOOD) == []
    assert bound_figures.bound(GOOD) == 5


@pytest.mark.parametrize(
    ("old", "planted", "line"),
    [
        (".827", ".828", 1),
        (".827", ".82", 1),  # .82708 is .83 to two decimals
        ("31 %", "32 %", 1),
        ("31 %", "31", 1),
        ("`dn_tas500`", "`ycor`", 2),
        ("-.004", ".004", 2),
        ("1,318", "1,319", 3),
        ("1,318", "1,300", 3),
    ],
)
def test_a_planted_stale_figure_is_found(old: str, planted: str, line: int) -> None:
    text = GOOD.replace(old, planted, 1)
    (found,) = bound_figures.stale(text, RECORDS, TABLES)
    assert found.line == line
    assert found.what.startswith(f"{planted}: ")
    assert (
        bound_figures.stale(bound_figures.rewritten(text, RECORDS, TABLES), RECORDS, TABLES) == []
    )


def test_a_figure_whose_record_is_gone_is_told() -> None:
    (found,) = bound_figures.stale(".5<!-- figure: gone -->", RECORDS, TABLES)
    assert found.what == ".5: no record is called gone"


def test_a_table_is_written_from_records_and_one_changed_cell_is_found() -> None:
    text = f"x\n<!-- table: scores -->\n{WRITTEN}<!-- end -->\n"
    assert bound_figures.stale(text, RECORDS, TABLES) == []
    empty = "x\n<!-- table: scores -->\n<!-- end -->\n"
    assert bound_figures.rewritten(empty, RECORDS, TABLES) == text

    (found,) = bound_figures.stale(text.replace(".827", ".826"), RECORDS, TABLES)
    assert found == (2, "table scores is not as its records have it")


def test_rows_fall_by_the_record_they_are_sorted_by() -> None:
    records = {"a.f": Record(0.1, "", ""), "b.f": Record(0.3, "", ""), "b.f@x": Record(0.5, "", "")}
    table = Table(("who", "F"), (("A", "a"), ("B", "b")), ("[[{row}.f{at}|.00]]",), sort="{row}.f")
    assert table(records).splitlines()[2:] == ["| B | .30 |", "| A | .10 |"]
    of_group = table._replace(rows=(("B at x", "b@x"),), sort="")
    assert of_group(records).splitlines()[2:] == ["| B at x | .50 |"]


def test_a_table_has_a_header_for_every_column() -> None:
    with pytest.raises(ValueError, match="1 headers over 2 columns"):
        SCORES._replace(header=("detector",))(RECORDS)


def test_a_table_names_the_record_that_is_missing() -> None:
    table = SCORES._replace(cells=("[[{row}.maxf|.000]]",))
    text = f"<!-- table: scores -->\n{WRITTEN}<!-- end -->"
    (found,) = bound_figures.stale(text, RECORDS, {"scores": table})
    assert found.what == "table scores: no record is called many.maxf"


def test_numbers_without_a_source_are_found_and_names_are_none() -> None:
    text = """# Title

```
F 0.5 in code
```
`0.5` of CNN-7, P1, CPFv2, dn_tas500, 0001TP, 8-bit; a [link](https://x.org/12.5), Python 3.11,
480×360 pixels, ECCV 2012, arXiv 1412.3506, CC BY 4.0, ROS 2; intervals of 95 %.

1. First: .5 here, and 17 there.

<!-- study: train/README.md -->
.9 was measured once.
<!-- end -->
"""
    assert bound_figures.unbound(text) == [(9, ".5"), (9, "17")]
    assert bound_figures.in_studies(text) == 1


def test_the_records_that_documents_use_are_named_each_once() -> None:
    text = f"{GOOD}{GOOD}<!-- table: scores -->\n<!-- end -->"
    used = list(bound_figures.names_used([text], TABLES))
    assert used.count("many.f") == 1
    assert set(used) == {
        "many.f",
        "many.worst",
        "flicker.left",
        "pairs.low",
        "pictures",
        "flicker.f",
    }


def test_records_are_read_as_they_are_written_and_no_name_stands_twice(tmp_path: Path) -> None:
    bound_figures.write_records(tmp_path / "a.json", RECORDS)
    assert bound_figures.read_records([tmp_path / "a.json"]) == RECORDS
    assert {*json.loads((tmp_path / "a.json").read_text())[0]} == {
        "name",
        "value",
        "unit",
        "command",
    }
    with pytest.raises(ValueError, match="is there twice"):
        bound_figures.read_records([tmp_path / "a.json"] * 2)
