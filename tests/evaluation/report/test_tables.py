"""Tables of an evaluation: on the screen, as Markdown, and what they leave out."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace

import pytest

from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.report.table import Cell, Table
from roadtorch.evaluation.report.tables import MAX_LISTED, build_tables, format_tables, shortlist
from roadtorch.evaluation.result import Comparison, Difference, Evaluation, Interval
from tests.reports import GROUPS, NAMES, make_run, make_scored_run, replace_scores


def texts(evaluation: Evaluation, limit: int | None = 20) -> Mapping[str, str]:
    """Return the tables as text by their title."""
    return {table.title: table.text() for table in build_tables(evaluation, limit)}


def test_a_table_is_text_and_markdown() -> None:
    table = Table("name", ["a|b", "c"], omitted=2)
    table.add("F", [Cell("0.912"), Cell("–")])
    table.add("change", [Cell("\N{MINUS SIGN}0.100", True, "\N{MINUS SIGN}0.2 to +0.1"), Cell("–")])

    assert table.text().splitlines() == [
        "name      F  change          95 %",
        "a|b   0.912  -0.100  -0.2 to +0.1",
        "c         -       -",
        "2 more rows: metrics.json (--out DIR)",
    ]
    assert table.to_markdown().splitlines() == [
        "| name | F | change |",
        "| --- | ---: | ---: |",
        "| a\\|b | 0.912 | \N{MINUS SIGN}0.100 (\N{MINUS SIGN}0.2 to +0.1) |",
        "| c | – | – |",
    ]


@pytest.mark.parametrize("groups", [3, 6, 30])
@pytest.mark.parametrize("name", ["fusion", "oneclass:" + "x" * 60])
def test_a_screen_has_100_columns_and_keeps_the_headline_and_its_interval(groups, name) -> None:
    run = make_run([name, "prior:rows"], [f"camera{number}" for number in range(groups)])

    lines = format_tables(run).splitlines()

    assert max(map(len, lines)) <= 100
    header = re.sub(" {2,}", "  ", lines[0])
    assert "F of mask  IoU of mask  MaxF  95 %" in header
    assert lines[1].split()[0] == name or "…" in lines[1]


def test_of_a_grid_the_best_are_shown_beside_all_baselines() -> None:
    worse = [f"oneclass:gaussian:{number}" for number in range(100)]
    evaluation = make_run(["fusion", *worse, "prior:rows", "prior:mean"])

    text = format_tables(evaluation)

    listed = ["fusion", *worse[: MAX_LISTED - 1], "prior:rows", "prior:mean"]
    assert shortlist(evaluation) == listed
    assert text.endswith("61 more detectors, with lower MaxF: metrics.json (--out DIR)")
    assert worse[MAX_LISTED - 2] in text
    assert worse[MAX_LISTED - 1] not in text


def test_of_many_groups_the_worst_are_shown_and_have_a_table_with_the_worst_on_top() -> None:
    cameras = [f"camera{number}" for number in range(30)]
    many = make_run(["fusion", "prior:rows"], cameras)
    worst, level = (many.detectors[name].groups["camera0"] for name in many.detectors)

    header, row = texts(many)["detector"].splitlines()[:2]
    by_group, whole = (texts(many, limit)["fusion by group"].splitlines() for limit in (20, None))

    assert "MaxF camera5" not in header
    assert "worst F of mask  worst MaxF" in re.sub(" {2,}", "  ", header)
    assert f"{worst['f_mask']:.3f} camera0" in row
    assert f"{worst['maxf']:.3f} camera0" in row
    assert by_group[1].split()[:2] == ["camera0", "10"]
    assert by_group[1].split()[-1] == f"{level['maxf']:.3f}"
    assert [line.split()[0] for line in by_group[20:]] == ["camera19", "mean", "10"]
    assert [line.split()[0] for line in whole[1:]] == [*cameras, "mean"]
    assert "fusion by group" not in texts(make_run(["fusion"]))
    assert "fusion by group" in texts(make_run(["fusion"]), None)


def test_groups_that_are_left_out_are_listed_below_the_mean() -> None:
    evaluation = make_run(["fusion"])
    groups = dict(evaluation.detectors["fusion"].groups)
    left_out = {GROUPS[0]: groups.pop(GROUPS[0])}

    tables = texts(replace_scores(evaluation, "fusion", groups=groups, left_out=left_out))

    assert f"MaxF {GROUPS[0]}" not in tables["detector"]
    rows = tables["fusion by group"].splitlines()[1:]
    assert [row.split("  ")[0] for row in rows] == [*GROUPS[1:], "mean", "0001TP (left out)"]


def test_only_detectors_with_trust_have_a_row_of_it() -> None:
    run = make_run(["fusion", "cpf"])
    headline = run.detectors["cpf"].headline
    silent = {key: value for key, value in headline.items() if not key.startswith("trust/")}

    lines = texts(replace_scores(run, "cpf", headline=silent))["trust"].splitlines()

    assert [line.split()[0] for line in lines] == ["trust", "fusion"]


def test_detectors_without_a_score_stand_last() -> None:
    unscored = make_scored_run({"d": math.nan, "a": math.nan, "c": 0.1, "b": None})

    assert unscored.ranking() == ["c", "a", "b", "d"]
    assert [line.split() for line in format_tables(unscored).splitlines()] == [
        *(["detector", "MaxF", "95", "%"], ["c", "0.100", "-"]),
        *([name, "-", "-"] for name in "abd"),
    ]


@pytest.mark.parametrize("key", [measure.key for measure in MEASURES])
def test_a_measure_that_is_missing_or_undefined_somewhere_is_a_dash(key: str) -> None:
    whole = make_run()
    scores = whole.detectors["fusion"]
    headline = {name: value for name, value in scores.headline.items() if name != key}
    groups = {**scores.groups, "0006R0": {}}
    lacking = replace_scores(whole, "fusion", headline=headline, groups=groups)
    undefined = {name: {**part, key: math.nan} for name, part in scores.groups.items()}
    nothing = {"labeller": {"maxf": Difference(math.nan, Interval())}, "cpf:v2": {}}
    run = replace_scores(replace(whole, comparison=Comparison("fusion", nothing)), "labeller",
                  groups=undefined, intervals={})  # fmt: skip

    for evaluation in (lacking, run):
        text = "".join(texts(evaluation, None).values())
        assert not re.search(r"\bnan\b|None", text)
        assert all(name in text for name in NAMES)
