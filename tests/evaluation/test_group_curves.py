"""Curves for files: the mean over groups, and what a list of points keeps."""

import numpy as np
import pytest
import torch

from roadtorch.evaluation import curves, metrics
from roadtorch.evaluation.document import mean_precision, mean_roc, risk_curves
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.trust import Trusted


def noisy(seed: int, gain: float, pixels: int = 4000) -> RoadCounts:
    generator = torch.Generator().manual_seed(seed)
    road = torch.rand(40, pixels // 40, generator=generator) < 0.4
    values = (gain * road + torch.rand(road.shape, generator=generator)) / (1 + gain)
    return metrics.count_levels(values, road, torch.ones_like(road))


def test_the_mean_of_equal_groups_is_the_group():
    counts = noisy(0, 0.5)

    roc, precision = mean_roc([counts, counts]), mean_precision([counts, counts])

    assert float(curves.area(roc)) == pytest.approx(float(metrics.auc(counts)), abs=0.004)
    assert torch.equal(precision.y, mean_precision([counts]).y)


def test_groups_weigh_the_same_whatever_their_size():
    small, big = noisy(1, 0.2, 4000), noisy(2, 2.0, 40000)

    area = float(curves.area(mean_roc([small, big])))

    means = [float(metrics.auc(counts)) for counts in (small, big)]
    assert area == pytest.approx(sum(means) / 2, abs=0.004)


def test_precision_at_a_recall_is_the_best_one_there_or_above():
    counts = noisy(3, 0.8)
    precision, recall = metrics.kitti_precision_recall(counts)

    found = mean_precision([counts])

    for step in (0.0, 0.25, 0.5, 0.9, 1.0):
        index = int(np.argmin(np.abs(found.x.numpy() - step)))
        expected = precision[recall >= found.x[index]].max()
        assert float(found.y[index]) == pytest.approx(float(expected), abs=1e-6)


def test_a_group_without_road_is_left_out_of_the_means():
    counts, empty = noisy(4, 0.8), noisy(4, 0.8)
    empty = RoadCounts(torch.zeros_like(empty.road), empty.other)

    assert torch.equal(mean_roc([counts, empty]).y, mean_roc([counts]).y)
    assert torch.equal(mean_precision([counts, empty]).y, mean_precision([counts]).y)


def test_risk_is_of_all_pictures_and_stands_beside_the_ideal_one():
    f = torch.tensor([0.9, 0.1, 0.8], dtype=torch.float64)
    pictures = Trusted(torch.tensor([0.5, 0.6, 0.7]), f, ["a", "b", "b"])

    found = risk_curves(pictures)

    assert found["risk"] == [[0.333333, 0.666667, 1], [0.2, 0.55, 0.4]]
    assert found["risk_ideal"] == [[0.333333, 0.666667, 1], [0.1, 0.15, 0.4]]
    assert risk_curves(None) == {}
