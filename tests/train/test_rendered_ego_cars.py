"""Rendered ego cars: the same each time, below in the picture, and no road upon them."""

import numpy as np
import pytest
import torch

from train.rendered_ego_cars import SHAPES, render_ego_car
from train.rendered_streets import truth_of

LOOKS = [np.random.default_rng(0).random((60, 80, 3)).astype(np.float32)]


@pytest.mark.parametrize("kind", SHAPES)
def test_an_ego_car_is_the_same_each_time(kind: str) -> None:
    scene, ego = render_ego_car(kind, 1, LOOKS)
    again, same_ego = render_ego_car(kind, 1, LOOKS)

    assert torch.equal(scene.image, again.image)
    assert torch.equal(ego, same_ego)


@pytest.mark.parametrize("kind", SHAPES)
def test_most_pictures_show_one_that_goes_down_to_the_lower_edge(kind: str) -> None:
    found = [render_ego_car(kind, number, LOOKS) for number in range(6)]
    shown = [(scene, ego) for scene, ego in found if ego.any()]

    assert len(shown) >= 3
    for scene, ego in shown:
        assert not (scene.road & ego).any()
        columns = ego.any(0)
        assert ego[-1, columns].all()
        assert float(ego.double().mean()) < 0.7
        assert set(truth_of(scene, ego)["ego"].unique().tolist()) == {0, 255}
