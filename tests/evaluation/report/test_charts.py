"""Charts: the lines are the numbers, and the text can stand in any page."""

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest

from roadtorch.evaluation.document import RunCurves
from roadtorch.evaluation.measures import F_MASK, MAXF
from roadtorch.evaluation.report import charts, svg
from tests.reports import GROUPS, made_row, made_run, scored

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def run():
    return made_run()


@pytest.fixture(scope="module")
def drawn(run) -> dict[str, str]:
    evaluation, curves, rows = run
    return charts.all_charts(evaluation, svg.choose_series(evaluation), curves, rows)


def texts(chart: str) -> list[str]:
    return [one.text or "" for one in ElementTree.fromstring(chart).iter(f"{SVG}text")]


def lines(chart: str, colour: str, width: float) -> list[np.ndarray]:
    """Points (n,2) of the lines with a colour and a width."""
    found = []
    for path in ElementTree.fromstring(chart).iter(f"{SVG}path"):
        style = path.get("style", "")
        if f"stroke: {svg.VARIABLES[colour]}" in style and f"stroke-width: {width:g}" in style:
            values = re.findall(r"[ML] (\S+) (\S+)", path.get("d", ""))
            found.append(np.array(values, dtype=float))
    return found


def assert_proportional(shown: np.ndarray, given: np.ndarray) -> None:
    """Points on the page are numbers times a factor, and moved, to half a point."""
    slope, offset = np.polyfit(given, shown, 1)
    assert abs(slope) > 1
    assert np.abs(slope * given + offset - shown).max() < 0.5


# --- which detectors -----------------------------------------------------------------------------


def test_the_eight_best_and_the_four_best_baselines_are_shown_by_rank():
    names = [f"d{i}" for i in range(12)] + [f"prior:{i}" for i in range(6)]
    scores = {name: 1 - i / 20 for i, name in enumerate(names)}

    found = svg.choose_series(scored(dict(reversed(scores.items()))))

    assert [one.name for one in found] == names[:8] + names[12:16]
    assert len({(one.colour, one.dash) for one in found}) == 12
    assert all(one.is_baseline == one.name.startswith("prior:") for one in found)
    unscored = scored({"d": math.nan, "a": math.nan, "c": 0.1, "b": None})
    assert unscored.ranked() == ["c", "a", "b", "d"]


# --- what is drawn -------------------------------------------------------------------------------


def test_intervals_of_maxf_are_where_they_belong(run, drawn):
    detectors = run[0].detectors
    colours = {one.name: one.colour for one in svg.choose_series(run[0]) if not one.is_baseline}

    ends = [lines(drawn["maxf"], colours[name], 2.6)[0][:, 0] for name in colours]

    given = [detectors[name].interval for name in colours]
    assert_proportional(np.concatenate(ends), np.concatenate(given))


@pytest.mark.parametrize(("name", "measure"), [("maxf", MAXF), ("f_mask", F_MASK)])
def test_scores_are_written_beside_every_row_and_baselines_stand_among_them(
    run, drawn, name, measure
):
    found = texts(drawn[name])

    for detector, figures in run[0].detectors.items():
        assert detector in found
        assert measure.text(measure.of(figures.headline), "") in found
    best_baseline = run[0].detectors["prior:mean"].headline[measure.key]
    assert f"best baseline {best_baseline:.3f}" in found
    assert f"{measure.line} (mean over groups)" in found
    assert set(GROUPS) <= set(found)


def test_differences_are_where_they_belong(run, drawn):
    changes = run[0].comparison.differences

    ends = lines(drawn["paired"], svg.COLOURS[1], 2.6) + lines(drawn["paired"], svg.BASELINE, 2.6)

    given = [changes[name]["maxf"].interval for name in ("labeller", "prior:mean", "prior:rows")]
    assert_proportional(np.concatenate(ends)[:, 0], np.concatenate(given))
    assert "fusion" not in texts(drawn["paired"])


@pytest.mark.parametrize(("name", "kind"), [("roc", "roc"), ("pr", "pr")])
def test_curves_pass_through_their_points(name, kind):
    points = [[0.0, 0.2, 0.6, 1.0], [1.0, 0.7, 0.9, 0.1]]
    series = [svg.Series("it", svg.COLOURS[0], ())]
    draw = {"roc": charts.roc_chart, "pr": charts.precision_chart}[name]

    chart = draw(series, {"it": {"mean": {kind: points}, "groups": {}}})

    shown = max(lines(chart, svg.COLOURS[0], 2), key=lambda line: np.ptp(line[:, 0]))
    assert_proportional(shown[:, 0], np.array(points[0]))
    assert_proportional(shown[:, 1], np.array(points[1]))


def test_risk_is_drawn_beside_the_ideal_one_and_the_mean():
    risk, ideal = [[0.25, 0.5, 1.0], [0.3, 0.1, 0.4]], [[0.25, 0.5, 1.0], [0.0, 0.05, 0.4]]
    series = [svg.Series("it", svg.COLOURS[0], ())]

    chart = charts.risk_chart(series, {"it": {"mean": {"risk": risk, "risk_ideal": ideal},
                                              "groups": {}}})  # fmt: skip

    for width, points in ((2, risk), (1.1, ideal)):
        shown = lines(chart, svg.COLOURS[0], width)[0]
        assert_proportional(shown[:, 0], np.array(points[0]))
        assert_proportional(shown[:, 1], np.array(points[1]))
    (random,) = lines(chart, svg.COLOURS[0], 0.7)
    end = lines(chart, svg.COLOURS[0], 2)[0][-1]
    assert random[:, 1].tolist() == [end[1], end[1]]


def test_groups_are_thin_lines_of_the_best_detector_alone(drawn):
    best, second = svg.COLOURS[:2]

    assert len(lines(drawn["roc"], best, 0.7)) == 2 * len(GROUPS)  # and in the enlarged corner
    assert not lines(drawn["roc"], second, 0.7)
    assert lines(drawn["roc"], second, 2)


def test_undefined_points_are_left_out():
    bins = [[0.1, math.nan, 0.9], [0.2, math.nan, 0.8], [0.5, 0, 0.5]]
    series = [svg.Series("it", svg.COLOURS[0], ())]

    chart = charts.reliability_chart(series, {"it": {"mean": {"reliability": bins}, "groups": {}}})

    assert all(np.isfinite(line).all() for line in lines(chart, svg.COLOURS[0], 1.8))
    assert "nan" not in chart


def test_every_picture_is_a_tick_and_thousands_are_thinned():
    series = [svg.Series("it", svg.COLOURS[0], ())]
    rows = [made_row("it", "", i / 10) for i in range(11)]
    rows += [made_row("it", "", math.nan), made_row("other", "", 0.3)]

    few = lines(charts.distribution_chart(series, rows), svg.COLOURS[0], 0.6)[0]
    many = charts.distribution_chart(series, [made_row("it", "", i / 9999) for i in range(9999)])

    assert len(few) == 2 * 11
    assert_proportional(few[::2, 0], np.arange(11) / 10)
    assert len(np.unique(lines(many, svg.COLOURS[0], 0.6)[0][:, 0])) == charts.MAX_TICKS


def test_many_groups_are_not_told_apart():
    groups = [f"group {i}" for i in range(40)]
    evaluation, _, rows = made_run(["it"], groups)
    series = svg.choose_series(evaluation)

    assert not set(groups) & set(texts(charts.distribution_chart(series, rows)))
    assert not set(groups) & set(texts(charts.score_chart(series, evaluation, MAXF)))


def test_nothing_to_draw_is_no_chart():
    series = [svg.Series("it", svg.COLOURS[0], ())]
    nothing = scored({"it": math.nan})

    def curves(kind: str, lines: list | None) -> RunCurves:
        return {"it": {"mean": {kind: lines}, "groups": {}}}

    assert charts.score_chart(series, nothing, MAXF) == ""
    assert charts.difference_chart(series, nothing.comparison) == ""
    assert charts.roc_chart(series, {}) == ""
    assert charts.precision_chart(series, curves("pr", [[], []])) == ""
    assert charts.reliability_chart(series, curves("reliability", None)) == ""
    assert charts.risk_chart(series, curves("roc", [[0, 1], [0, 1]])) == ""
    assert charts.distribution_chart(series, []) == ""


# --- the text ------------------------------------------------------------------------------------


def test_names_are_text_and_only_text():
    name = "<b>$x_1$ 道 \x01"
    series = [svg.Series(name, svg.COLOURS[0], ())]

    chart = charts.score_chart(series, scored({name: 0.5}), MAXF)

    assert "<b>$x_1$ 道 ?" in texts(chart)
    assert "<b>" not in chart


def test_a_long_name_keeps_both_ends():
    found = svg.short("oneclass:" + "x" * 100 + ":linear")

    assert len(found) == svg.MAX_LETTERS
    assert (found[:9], found[-7:]) == ("oneclass:", ":linear")


def test_charts_bring_nothing_that_acts_on_the_page_and_colours_that_it_may_change(drawn):
    for chart in drawn.values():
        tags = {one.tag.removeprefix(SVG) for one in ElementTree.fromstring(chart).iter()}
        assert not tags & {"style", "script", "metadata", "image", "a"}
        assert chart.startswith("<svg ")
        assert "viewBox" in chart
        assert set(re.findall(r'href="(.)', chart)) <= {"#"}
        assert set(re.findall(r"url\((.)", chart)) <= {"#"}
        assert not re.findall(r"(?:fill|stroke): (#\w+)", chart)
    ids = [set(re.findall(r'\bid="([^"]+)"', chart)) for chart in drawn.values()]
    assert sum(map(len, ids)) == len(set().union(*ids))  # none is shared


def test_the_same_numbers_give_the_same_text_whatever_the_user_prefers(run, drawn):
    series = svg.choose_series(run[0])

    with matplotlib.rc_context({"font.size": 30, "axes.facecolor": "red"}):
        again = charts.score_chart(series, run[0], MAXF)
        assert matplotlib.rcParams["font.size"] == 30

    assert again == drawn["maxf"]


def test_pyplot_and_its_windows_stay_out():
    sources = Path(charts.__file__).parent.glob("*.py")

    assert [path.name for path in sources if "pyplot" in path.read_text(encoding="utf-8")] == []
