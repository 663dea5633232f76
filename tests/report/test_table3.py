"""P3's Table III: its own values, what a run puts beside them, and the figures with it."""

import csv
import io
import math
import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest
from defusedxml.ElementTree import fromstring
from scipy.stats import spearmanr

from roadtorch.evaluation.document import DetectorCurves, RunCurves
from roadtorch.imaging.color import REPRESENTATIONS
from roadtorch.oneclass import CLASSIFIERS
from roadtorch.report.files import write_table3
from roadtorch.report.roc_families import looks, mean_line, roc_families
from roadtorch.report.table3 import (
    best_cells,
    measured_table,
    printed_table,
    rank_correlations,
    table_csv,
    table_html,
    table_text,
)
from tests.reports import changed, made_run

ROC = {"roc_vertical": [[0, 0, 0.5, 1], [0, 0.4, 0.8, 1]]}
NAMES = ("oneclass:gaussian:RGB", "oneclass:nn:RGB", "oneclass:nn:S", "fusion", "prior:rows")


def test_p3s_table_has_all_its_values() -> None:
    table = printed_table()

    assert len(table) == 17 * 19 - 13 - 3  # PCA is empty in single planes and pairs
    assert {key[0] for key in table} == set(CLASSIFIERS)
    assert {key[1] for key in table} == set(REPRESENTATIONS)
    # The best of all, the worst, and the corners of both halves.
    assert max(table, key=table.__getitem__) == ("robust_gaussian", "HS")
    assert table["robust_gaussian", "HS"] == 93.4
    assert min(table.values()) == table["hist64_s", "HS"] == table["hist100_s", "HSV"] == 53.2
    assert (table["nn", "R"], table["kcentres", "V"]) == (74.2, 83.6)
    assert (table["nn", "RGB"], table["kcentres", "HS"]) == (83.1, 93.1)
    assert table["pca", "HSV"] == 89.3


def test_cells_are_the_mean_areas_in_percent_of_a_run_and_of_its_groups() -> None:
    evaluation, _, _ = made_run(NAMES)
    figures = evaluation.detectors["oneclass:nn:S"]
    groups = {**figures.groups, "0001TP": {**figures.groups["0001TP"], "auc_mean": math.nan}}
    evaluation = changed(evaluation, "oneclass:nn:S", groups=groups)

    whole, group = (measured_table(evaluation, name) for name in (None, "0001TP"))

    assert list(whole) == [("nn", "S"), ("nn", "RGB"), ("gaussian", "RGB")]
    assert whole["nn", "S"] == pytest.approx(100 * figures.headline["auc_mean"])
    assert list(group) == [("nn", "RGB"), ("gaussian", "RGB")]  # an undefined one is left out


def test_the_best_of_a_column_is_told_to_the_printed_decimal() -> None:
    table = {("nn", "R"): 80.04, ("mst", "R"): 79.96, ("mpm", "R"): 79.9, ("mpm", "G"): 50.0}

    assert best_cells(table, ["R"]) == {("nn", "R"), ("mst", "R")}


def test_ranks_agree_with_scipy_and_with_hand() -> None:
    paper = printed_table()
    turned = {key: 100 - value for key, value in paper.items()}

    halved = {key: value // 10 for key, value in paper.items()}  # many equal ones
    scipys = spearmanr([halved[key] for key in paper], list(paper.values()))[0]

    same = {name: (count, value) for name, count, value in rank_correlations(paper, paper)}
    opposite = [value for _, _, value in rank_correlations(turned, paper)]

    assert {name: count for name, (count, _) in same.items()} == {
        "all cells": 307,
        "single planes": 208,
        "combinations": 99,
        "means of columns, single planes": 13,
        "means of rows, single planes": 16,
        "means of columns, combinations": 6,
        "means of rows, combinations": 17,
    }
    assert [value for _, value in same.values()] == pytest.approx([1] * 7)
    assert opposite == pytest.approx([-1] * 7)
    assert next(rank_correlations(halved, paper))[2] == pytest.approx(scipys)


def test_cells_that_p3_left_empty_are_not_ranked() -> None:
    ours = {("pca", "RGB"): 80.0, ("pca", "HS"): 70.0, ("nn", "RGB"): 75.0}

    counts = {name: count for name, count, _ in rank_correlations(ours, printed_table())}

    assert counts == {"all cells": 2, "combinations": 2, "means of rows, combinations": 2}


def test_text_has_the_layout_the_baselines_and_the_best() -> None:
    evaluation, _, _ = made_run(NAMES)

    text = table_text(evaluation)

    lines = text.splitlines()
    of = "30 pictures of camvid dev, mean over 0001TP, 0006R0, 0016E5"
    assert f"{of}; blind baselines: prior:rows" in text
    assert [line.split() for line in lines if line.startswith("classifier")] == [
        ["classifier", "S"],
        ["classifier", "RGB"],
    ]
    best, other = (next(line for line in lines[6:] if line.startswith(name)).split()[1]
                   for name in ("gaussian", "nn"))  # fmt: skip
    ours = 100 * evaluation.detectors["oneclass:gaussian:RGB"].headline["auc_mean"]
    assert best == f"*{ours:.1f}/90.9"
    assert other.endswith("/83.1")
    assert not other.startswith("*")
    assert "all cells (3): +0.50" in text  # ranks 3 2 1 and 3 1 2
    assert "nan" not in text


def test_a_run_without_the_family_has_no_table(tmp_path) -> None:
    evaluation, curves, _ = made_run()

    write_table3(tmp_path, evaluation, curves)

    assert table_text(evaluation) == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "method", "is_ours"),
    [("RGB", "reweighted", True), ("RGB", "huber", False), ("RGB:paper", "huber", False)],
)
def test_a_table_names_the_classifiers_that_are_not_p3s(name, method, is_ours) -> None:
    name = f"oneclass:robust_gaussian:{name}"
    evaluation, _, _ = made_run((*NAMES, name))
    scored = evaluation.detectors[name].method
    told = replace(scored, settings={"classifier": {"method": method}})
    evaluation = changed(evaluation, name, method=told)

    note = "not the paper&#39;s to the letter: robust_gaussian (oneclass:"
    assert ("robust_gaussian", "RGB") in measured_table(evaluation)
    assert (note in table_html(evaluation)) == is_ours
    assert (note.replace("&#39;", "'") in table_text(evaluation)) == is_ours


def test_what_is_to_the_letter_goes_before_what_is_ours() -> None:
    both = ("oneclass:dlp:RGB", "oneclass:dlp:RGB:paper")
    evaluation, _, _ = made_run((*NAMES, *both))

    letter = evaluation.detectors[both[1]].headline["auc_mean"]
    assert letter != evaluation.detectors[both[0]].headline["auc_mean"]
    assert measured_table(evaluation)["dlp", "RGB"] == 100 * letter


@pytest.mark.parametrize("groups", [("0001TP", "0016E5"), ()], ids=["groups", "whole"])
def test_csv_has_p3s_value_and_the_groups(groups) -> None:
    evaluation, _, _ = made_run(NAMES, groups)

    rows = list(csv.DictReader(io.StringIO(table_csv(evaluation))))

    assert [(row["classifier"], row["representation"]) for row in rows] == [
        ("nn", "S"),
        ("nn", "RGB"),
        ("gaussian", "RGB"),
    ]
    last, figures = rows[-1], evaluation.detectors["oneclass:gaussian:RGB"]
    assert last["paper"] == "90.9"
    assert float(last["auc"]) == pytest.approx(100 * figures.headline["auc_mean"], abs=0.005)
    for group in groups:
        assert float(last[group]) == pytest.approx(
            100 * figures.groups[group]["auc_mean"], abs=0.005
        )


def test_html_marks_the_best_and_says_p3s_values_small() -> None:
    evaluation, _, _ = made_run(NAMES)
    evaluation = replace(evaluation, dataset=replace(evaluation.dataset, name="<b>"))

    page = table_html(evaluation)

    ours = 100 * evaluation.detectors["oneclass:gaussian:RGB"].headline["auc_mean"]
    assert f"<b>{ours:.1f}</b><small>90.9</small></td>" in page
    assert "&lt;b&gt; dev" in page
    captions = [part.split("<")[0] for part in page.split("<h2>")[1:]]
    assert captions[:3] == ["all, single planes", "all, combinations", "0001TP, single planes"]
    assert len(captions) == 8


def test_files_of_a_run(tmp_path) -> None:
    evaluation, _, _ = made_run(NAMES)
    curves: RunCurves = {name: {"mean": {}, "groups": {"a": ROC, "b": ROC}} for name in NAMES}

    write_table3(tmp_path, evaluation, curves)

    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"table3.txt", "table3.csv", "table3.html", "fig9.svg"}  # no histogram ran
    svg = (tmp_path / "fig9.svg").read_text()
    assert "var(" not in svg  # for viewers that know no variables
    fromstring(svg)


# --- the curves -------------------------------------------------------------------------


def test_a_line_is_the_mean_over_groups_or_the_sets_own() -> None:
    by_group: DetectorCurves = {"mean": {}, "groups": {
        "a": {"roc_vertical": [[0, 0.5, 1], [0, 0.5, 1]]},
        "b": {"roc_vertical": [[0, 0.5, 1], [0, 0.9, 1]]},
    }}  # fmt: skip
    whole: DetectorCurves = {"mean": {"roc_vertical": [[0, 1], [0.5, 1]]}, "groups": {}}

    line, own = mean_line(by_group), mean_line(whole)

    assert line is not None
    assert own is not None
    assert line[0].tolist() == [0, 0.5, 1]
    assert line[1].tolist() == pytest.approx([0, 0.7, 1])
    assert own.tolist() == [[0, 1], [0.5, 1]]
    assert mean_line(None) is None


def test_lines_differ_in_colour_or_dash() -> None:
    series = looks([str(number) for number in range(64)])

    assert len({(one.colour, one.dash) for one in series}) == 64
    assert len({one.colour for one in series[:8]}) == 8


def test_every_classifier_has_a_row_of_panels_with_its_lines() -> None:
    curves: RunCurves = {name: {"mean": ROC, "groups": {}} for name in NAMES}
    halves = {"left": ("S",), "right": ("RGB",)}

    def texts(*classifiers: str) -> list[str]:
        svg: ET.Element = fromstring(roc_families(curves, "oneclass:", classifiers, halves))
        return [element.text or "" for element in svg.iter() if element.tag.endswith("text")]

    both = texts("nn", "gaussian", "mst")  # the last one did not run
    assert [text for text in both if "," in text] == [
        "nn, left",
        "nn, right",
        "gaussian, left",
        "gaussian, right",
    ]
    assert {"S", "RGB"} <= set(both)
    assert roc_families(curves, "oneclass:", ["mst"], halves) == ""
