"""Rendered scenes: what the other tests take for granted about them."""

import pytest
import torch

from roadtorch.testing.scenes import CAR, ROAD, SKY, VOID, render_scene


def test_a_seed_is_one_scene():
    first, again, other = render_scene(3, 60, 80), render_scene(3, 60, 80), render_scene(4, 60, 80)

    assert torch.equal(first.image, again.image)
    assert torch.equal(first.classes, again.classes)
    assert not torch.equal(first.image, other.image)


@pytest.mark.parametrize("size", [(240, 320), (97, 131)])
def test_parts_have_the_size_and_types_promised(size):
    scene = render_scene(0, *size)

    assert scene.image.shape == (3, *size)
    assert scene.image.dtype == torch.float32
    assert 0 <= scene.image.min() < scene.image.max() <= 1
    for part, kind in (
        (scene.road, torch.bool),
        (scene.layout, torch.uint8),
        (scene.void, torch.bool),
    ):
        assert part.shape == size
        assert part.dtype == kind


@pytest.mark.parametrize("seed", range(6))
def test_every_scene_has_road_ahead_pavement_sky_and_walls(seed):
    scene = render_scene(seed, 120, 160)

    assert torch.equal(scene.road, scene.classes == ROAD)
    assert torch.equal(scene.layout == 0, scene.classes == SKY)
    assert torch.equal(scene.void, scene.classes == VOID)
    assert (scene.layout[scene.road] == 2).all()
    assert 0.12 < scene.road.float().mean() < 0.6
    assert all((scene.layout == kind).float().mean() > 0.02 for kind in range(3))
    assert not scene.road[:20].any()
    # The seed area of the papers: 30 by 80 at the bottom centre of 240 by 320.
    assert scene.road[105:, 60:100].float().mean() > 0.9
    assert scene.void.any()


def test_straight_road_is_where_geometry_says():
    # Horizon at row 60 of 120, camera 1.35 m up on the middle of a 7 m road: at the row
    # whose depth is z metres the half road is 3.5·f/z pixels wide, f = 0.95·160.
    scene = render_scene(
        5, 120, 160, horizon=0.5, curvature=0, heading=0, offset=0, road_width=7, cars=0
    )

    row = 80
    depth = 0.95 * 160 * 1.35 / (row + 0.25 - 60)
    half = 3.5 * 0.95 * 160 / depth
    columns = torch.nonzero(scene.road[row]).flatten()
    assert columns.min() == pytest.approx(80 - half, abs=1)
    assert columns.max() == pytest.approx(80 + half, abs=1)


def test_light_changes_the_picture_and_not_the_truth():
    noon, dusk = render_scene(2, 60, 80, dusk=0.0), render_scene(2, 60, 80, dusk=0.9)
    bare, shaded = render_scene(2, 60, 80, shadows=0), render_scene(2, 60, 80, shadows=3)

    assert dusk.image.mean() < 0.8 * noon.image.mean()
    assert shaded.image[:, shaded.road].mean() < 0.95 * bare.image[:, bare.road].mean()
    assert torch.equal(noon.classes, dusk.classes)
    assert torch.equal(bare.classes, shaded.classes)


def test_cars_stand_on_the_road_and_are_not_road():
    empty, busy = render_scene(2, 120, 160, cars=0), render_scene(2, 120, 160, cars=3)

    covered = empty.road & ~busy.road
    assert covered.sum() > 20
    assert (busy.classes[covered] == CAR).all()
    assert torch.equal(empty.road[busy.classes != CAR], busy.road[busy.classes != CAR])


def test_an_unknown_option_is_refused():
    with pytest.raises(TypeError, match="rain"):
        render_scene(0, 60, 80, rain=1)
