"""Charts of an evaluation: what they draw, and their bytes."""

import base64
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import torch
from matplotlib.figure import Figure

from roadtorch.evaluation import curves, metrics
from roadtorch.evaluation.measures import F_MASK
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.report import charts
from roadtorch.evaluation.report.table import shorten
from roadtorch.evaluation.result import Evaluation
from tests.evaluation.conftest import count
from tests.oracle import GROUPS, ORACLE
from tests.reports import make_scored_run


def noisy(seed: int, gain: float, pixels: int = 4000) -> RoadCounts:
    generator = torch.Generator().manual_seed(seed)
    road = torch.rand(40, pixels // 40, generator=generator) < 0.4
    values = (gain * road + torch.rand(road.shape, generator=generator)) / (1 + gain)
    return count(values, road)


def test_groups_weigh_the_same_whatever_their_size_and_those_without_road_nothing() -> None:
    small, big = noisy(1, 0.2, 4000), noisy(2, 2.0, 40000)
    empty = RoadCounts(torch.zeros_like(small.road), small.background)

    area = float(curves.area(charts.mean_roc([small, big])))

    assert area == pytest.approx(float(metrics.auc(small) + metrics.auc(big)) / 2, abs=0.004)
    assert torch.equal(charts.mean_roc([small, empty]).y, charts.mean_roc([small]).y)


def test_the_eight_best_and_the_four_best_baselines_are_shown_by_rank() -> None:
    names = [f"d{i}" for i in range(12)] + [f"prior:{i}" for i in range(6)]
    scores = {name: 1 - i / 20 for i, name in enumerate(names)}

    series = charts.choose_series(make_scored_run(dict(reversed(scores.items()))))

    assert [item.name for item in series] == names[:8] + names[12:16]
    assert len({(item.colour, item.dash) for item in series}) == 12
    assert all(item.is_baseline == item.name.startswith("prior:") for item in series)


def test_lines_and_marks_show_the_scores(oracle_run: Evaluation) -> None:
    series = charts.choose_series(oracle_run)
    roc, reliability, groups = Figure(), Figure(), Figure()

    charts.draw_roc(roc, series, oracle_run)
    charts.draw_reliability(reliability, series, oracle_run)
    charts.draw_groups(groups, series, oracle_run)

    lines = {line.get_label(): line for line in roc.axes[0].lines}
    mean = charts.mean_roc(charts.group_counts(oracle_run, "prior:rows"))
    assert np.array_equal(lines["prior:rows"].get_xydata(), torch.stack([*vars(mean).values()]).T)
    assert len(roc.axes[0].lines) == 1 + 4 + len(GROUPS)  # chance, detectors, groups of the best
    lines = {line.get_label(): line for line in reliability.axes[0].lines}
    counts = charts.group_counts(oracle_run, ORACLE)
    observed = torch.stack([curves.reliability(part).observed for part in counts]).nanmean(0)
    assert np.array_equal(lines[ORACLE].get_ydata(), observed, equal_nan=True)
    marks = {line.get_label(): line.get_xdata() for line in groups.axes[0].lines}
    labels = [text.get_text() for text in groups.axes[0].get_yticklabels()]
    for name, values in marks.items():
        scores = oracle_run.detectors[str(name)].groups
        assert np.array_equal(values, [F_MASK.get(scores[group]) for group in labels])


def test_names_are_text_and_long_ones_keep_both_ends() -> None:
    assert shorten("<b>$x$ \x01", 34) == "<b>$x$ ?"
    short = shorten("oneclass:" + "x" * 100 + ":linear", 34)
    assert len(short) == 34
    assert (short[:9], short[-7:]) == ("oneclass:", ":linear")


def test_equal_scores_give_equal_bytes_whatever_the_matplotlibrc() -> None:
    def draw(figure: Figure) -> None:
        figure.subplots().set_xlabel("<b>$x_1$ \N{CJK UNIFIED IDEOGRAPH-9053}")

    expected = charts.svg_uri(90, 90, draw)
    with matplotlib.rc_context({"font.size": 30, "axes.facecolor": "red"}):
        assert charts.svg_uri(90, 90, draw) == expected
        assert matplotlib.rcParams["font.size"] == 30
    svg = base64.b64decode(expected.split(",")[1]).decode()
    assert "<b>" not in svg
    assert "&lt;b&gt;$x_1$ \N{CJK UNIFIED IDEOGRAPH-9053}" in svg
    assert not any(tag in svg for tag in ("<script", "<image", "<a "))


def test_pyplot_and_its_windows_stay_out() -> None:
    sources = Path(charts.__file__).parent.glob("*.py")

    assert [path.name for path in sources if "pyplot" in path.read_text(encoding="utf-8")] == []
