"""Comparison of weights: obstacles, halves, the side of traffic."""

import numpy as np
import pytest
import torch

from train.compare import (
    LEFT,
    RIGHT,
    Records,
    draw_weights,
    half_errors,
    mean_f,
    obstacle_mask,
    obstacles_taken,
    world_kind,
    wrong_halves,
)


def test_kinds_of_worlds_keep_night_and_generation_apart() -> None:
    names = ["39001_town_night", "39008_town_sun", "49001_town_sun"]
    assert [world_kind(name) for name in names] == ["3 town night", "3 town", "4 town"]


def test_an_obstacle_has_road_above_and_below_it() -> None:
    road = torch.tensor([[0, 1, 1], [0, 0, 0], [1, 0, 1]], dtype=torch.bool)
    vertical = torch.tensor([[1, 0, 0], [1, 1, 1], [0, 1, 0]], dtype=torch.bool)
    assert obstacle_mask(road, vertical).nonzero().tolist() == [[1, 2]]


def test_errors_of_a_half_are_fractions_of_the_true_road() -> None:
    counts = torch.tensor([[30, 5, 10, 50, 20, 10, 0, 0], [10, 0, 0, 10, 0, 0, 0, 0]])
    counts = torch.cat([counts, torch.tensor([[0, 7, 0, 0, 3, 0, 0, 0]])])
    cameras = np.array(["a", "b", "roadless"])
    records = Records(cameras, [()] * 3, counts, torch.zeros(3, 2, 4))
    weights = draw_weights(cameras)

    def first(score) -> float:
        return float(score(records, weights)[0])

    assert first(half_errors("a", LEFT, 2)) == pytest.approx(10 / 100)
    assert first(half_errors("a", RIGHT, 1)) == pytest.approx(20 / 100)
    assert first(mean_f) == pytest.approx((160 / 205 + 1) / 2)
    assert torch.equal(mean_f(records, weights), mean_f(records, weights[:1]).expand(1001))


def test_wrong_halves_follow_the_side_of_traffic_and_few_pixels_that_stand_are_no_figure() -> None:
    counts = [[60, 5, 10, 20, 4, 10, 30, 300], [60, 5, 10, 20, 4, 10, 400, 500]]
    counts += [[60, 5, 10, 20, 4, 10, 0, 200]]
    cameras = np.array(["cityscapes", "dn_idd", "kitti_semantics"])
    records = Records(cameras, [()] * 3, torch.tensor(counts), torch.zeros(3, 2, 4))
    weights = draw_weights(cameras)[:1]

    assert wrong_halves("cityscapes")(records, weights) == pytest.approx((10 + 4) / 100)
    assert wrong_halves("dn_idd")(records, weights) == pytest.approx((5 + 10) / 100)
    assert obstacles_taken(records, weights) == pytest.approx((0.1 + 0.8) / 2)
    assert obstacles_taken(records, weights, ["dn_idd"]) == pytest.approx(0.8)
    assert obstacles_taken(records, weights, ["kitti_semantics"]).isnan()
