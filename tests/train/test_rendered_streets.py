"""Rendered streets of many kinds: their truth is that of the picture."""

import pytest
import torch

from train.rendered_streets import KINDS, PREPARED, render_street, truth_of


@pytest.mark.parametrize("kind", KINDS)
def test_a_street_is_the_same_each_time_and_has_all_that_a_street_has(kind: str) -> None:
    scene, ego = render_street(kind, 3)
    again, same_ego = render_street(kind, 3)

    assert torch.equal(scene.image, again.image)
    assert torch.equal(ego, same_ego)
    assert {0, 1, 2} <= set(scene.layout.unique().tolist())
    assert 0.02 < float(scene.road.double().mean()) < 0.8


def test_there_is_no_road_on_an_ego_car() -> None:
    found = [render_street("streets", number) for number in range(8)]
    with_ego = [(scene, ego) for scene, ego in found if ego.any()]

    assert 0 < len(with_ego) < len(found)
    for scene, ego in with_ego:
        assert not (scene.road & ego).any()
        truth = truth_of(scene, ego)
        assert truth["maps"].shape == (4, *PREPARED)
        assert truth["image"].shape == (3, *PREPARED)
        assert set(truth["ego"].unique().tolist()) == {0, 255}
        assert int(truth["maps"][3][truth["ego"] == 255].max()) < 255
