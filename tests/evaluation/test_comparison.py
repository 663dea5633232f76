"""Intervals hold the figure; pairs are compared on the same draws."""

import math

import pytest
import torch

from roadtorch.data.catalogue import open_dataset
from roadtorch.detector import Detection
from roadtorch.evaluation import uncertainty
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.result import DetectorFigures
from roadtorch.scenes.street import render_scene
from tests.evaluation.conftest import counted, summarised
from tests.reports import made_contender
from tests.streets import write_camvid

GROUPS = ("0001TP", "0006R0")
SCENES = {f"{GROUPS[i % 2]}_{i}": render_scene(i, 48, 64) for i in range(12)}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    root = tmp_path_factory.mktemp("camvid")
    write_camvid(root, "train", SCENES)
    return open_dataset("camvid", root, "train")


def measured(dataset, noise: float) -> tuple[DetectorFigures, uncertainty.Draws]:
    """Figures and draws of a detector whose road is that much blurred by noise."""

    def look(image, item):
        generator = torch.Generator().manual_seed(int(item.name[7:]))
        blur = torch.rand(48, 64, generator=generator)
        likelihood = (1 - noise) * SCENES[item.name].road + noise * blur
        scores = SCENES[item.name].layout
        layout = torch.stack([(scores == kind).float() for kind in range(3)]) + blur * noise * 3
        return Detection(likelihood, likelihood > 0.5, {"layout": layout})

    tally = counted(dataset, look)
    figures = summarised(tally)
    return figures, uncertainty.resample(tally, figures)


def test_every_headline_figure_has_an_interval_around_it(dataset):
    figures, draws = measured(dataset, 0.7)

    found = uncertainty.intervals(draws)

    names = {
        *("maxf", "auc_pooled", "auc_mean", "ap", "eer", "brier"),
        *("iou", "f", "f_mask", "iou_mask", "layout/mean"),
    }
    assert set(found) == names == {one.key for one in MEASURES if one.interval}
    for name, (low, high) in found.items():
        assert low <= figures.headline[name] <= high
        assert 0 <= high - low < 0.2
    assert found["maxf"][1] > found["maxf"][0]


def test_a_detector_is_no_better_than_itself_and_pairs_are_signed(dataset):
    good, poor = (measured(dataset, noise)[1] for noise in (0.72, 0.75))

    found = uncertainty.compare({"good": good, "poor": poor, "again": good}, "good").differences
    other = uncertainty.compare({"poor": poor, "good": good}, "poor").differences

    assert found["again"]["maxf"].value == 0
    assert found["again"]["maxf"].interval == (0, 0)
    assert found["poor"]["maxf"].interval.high < 0  # worse on every picture
    assert found["poor"]["brier"].interval.low > 0
    low, high = found["poor"]["maxf"].interval
    assert other["good"]["maxf"].interval == pytest.approx((-high, -low))
    # Paired, the interval is far narrower than those of the two figures.
    alone = uncertainty.intervals(poor)["maxf"]
    assert high - low < 0.7 * (alone.high - alone.low)


def test_pairs_share_the_figures_that_both_have(dataset):
    full, roadless = measured(dataset, 0.6)[1], dict(measured(dataset, 0.7)[1])
    del roadless["layout/mean"]

    found = uncertainty.compare({"a": full, "b": roadless}, "a").differences["b"]

    assert "layout/mean" not in found
    assert "maxf" in found


def test_the_others_are_compared_with_the_best_unless_somebody_is_named():
    figures = {
        name: DetectorFigures(made_contender(name), {"maxf": score})
        for name, score in {"a": 0.5, "b": 0.9, "c": math.nan}.items()
    }

    assert uncertainty.best_of(figures) == "b"
    assert uncertainty.best_of({"c": figures["c"]}) == "c"
