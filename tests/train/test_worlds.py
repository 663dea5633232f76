"""Rendered worlds without Blender: plans, lenses, truth of thin objects, framing."""

import tomllib
from collections import Counter
from pathlib import Path
from random import Random

import numpy as np
import pytest

from roadtorch.camera.ground import Lens, project_rays
from train.worlds.framing import measure_framing, predict_one_sided, select_worlds
from train.worlds.lens import (
    SENSOR,
    angle_polynomial,
    bend,
    image_circle,
    sample_fisheye,
    write_lens,
)
from train.worlds.plans import FISHEYES, HELD_OUT, SCHEDULE, SCHEDULED, STREETS, TOWNS, plan_world
from train.worlds.sensor import develop
from train.worlds.truth import HORIZONTAL, ROAD, VERTICAL, VOID, settle_truth


@pytest.mark.parametrize("first", [SCHEDULED, SCHEDULED + 17, SCHEDULED + HELD_OUT + 5])
def test_any_stretch_of_numbers_is_balanced(first: int) -> None:
    plans = [plan_world(number) for number in range(first, first + len(SCHEDULE))]
    names = Counter(plan.name for plan in plans)
    towns = [plan for plan in plans if plan.kinds == {"town": 1}]
    assert names["fisheyefront"] == names["fisheyerear"] == 1
    assert names["fisheyeside"] == 2
    assert names["people"] == 4
    assert len(towns) == 12
    assert sum(plan.hours == {"night": 1} for plan in towns) == 4
    assert sum(plan.wet is True for plan in towns) == 4


@pytest.mark.parametrize("first", [TOWNS, TOWNS + HELD_OUT + 7])
def test_streets_are_equal_parts_of_light_weather_and_side_of_traffic(first: int) -> None:
    plans = [plan_world(number) for number in range(first, first + len(STREETS))]
    towns = [plan for plan in plans if plan.kinds == {"town": 1}]
    parts = Counter((plan.name, "sun" in plan.hours, plan.hand) for plan in towns)
    assert len(towns) > 0.7 * len(plans)
    assert set(parts.values()) == {6}
    assert len(parts) == 6  # dry by day, at night, in rain; right, left
    fisheyes = sum(plan.mount in FISHEYES for plan in plans)
    assert 1 / 6 <= fisheyes / len(plans) <= 1 / 5


@pytest.mark.parametrize("seed", range(12))
def test_a_sampled_fisheye_is_the_lens_that_is_written(seed: int) -> None:
    fisheye = sample_fisheye(Random(seed), 384, 288)
    table = tomllib.loads(write_lens(fisheye, {"pitch": 30.0}))
    mount = table.pop("mount")
    lens = Lens(**{**table, "coefficients": tuple(table["coefficients"])})
    angles = np.linspace(0.05, np.radians(fisheye.view / 2), 7)
    radii = bend(angles, fisheye.coefficients)

    pixels, _ = project_rays(lens, np.stack([np.sin(angles), np.zeros(7), np.cos(angles)], 1))
    assert pixels[:, 0] == pytest.approx(fisheye.centre_x + fisheye.focal_x * radii, abs=0.01)
    assert mount["view"] == pytest.approx(fisheye.view, abs=0.01)

    millimetres = radii * fisheye.focal_x / fisheye.width * SENSOR
    weights = angle_polynomial(fisheye)
    fitted = sum(weight * millimetres**k for k, weight in enumerate(weights))
    assert np.abs(fitted - angles).max() * fisheye.focal_x < 0.3  # pixels


def test_beyond_the_circle_of_a_fisheye_the_image_is_black_and_void() -> None:
    fisheye = sample_fisheye(Random(3), 96, 72)._replace(focal_x=20.0, focal_y=20.0)
    circle = image_circle(fisheye)
    light = np.ones((72, 96, 3), np.float32)
    look = develop(
        light, np.full((72, 96), ROAD, np.uint8), "sun", np.random.default_rng(0), circle=circle
    )
    assert (look.truth == np.where(circle, ROAD, VOID)).all()
    assert look.image[:4, :4].max() < 60 < look.image[30:40, 40:50].min()


def test_a_pixel_is_vertical_from_a_third_on() -> None:
    codes = np.full((3, 9), ROAD, np.uint8)
    codes[:, 1] = VERTICAL  # a post of a third of a pixel
    codes[:2, 4] = VERTICAL  # less
    codes[:, 6:8] = HORIZONTAL
    assert settle_truth(codes, 3).tolist() == [[VERTICAL, ROAD, HORIZONTAL]]


def test_framing_tells_where_the_road_leaves_the_image() -> None:
    road, valid = np.zeros((10, 50), bool), np.ones((10, 50), bool)
    road[4:, :30] = True
    road[8:] = True
    framing = measure_framing(road, valid)
    assert framing is not None
    assert framing.asymmetry == pytest.approx((150 - 70) / 220)
    assert framing.left_only == pytest.approx(4 / 6)
    assert framing.right_only == 0

    valid[:, 0] = False  # a border column that nobody labelled
    cropped = measure_framing(road, valid)
    assert cropped is not None
    assert cropped.left_only == framing.left_only
    assert measure_framing(road & False, valid) is None


def test_a_road_beyond_the_image_on_one_side_is_predicted_as_rendered() -> None:
    """Mark the ground row by row, as a level camera sees a straight road."""
    near, far, height, up, across, turn = 1.8, 7.5, 1.4, 0.4, 0.55, 0.05
    slopes = (np.arange(400) + 0.5) / 400 * up
    columns = np.linspace(-across, across, 801)
    ground = (columns - turn)[None] * height / slopes[:, None]  # metres to the right
    rows = (ground > -far) & (ground < near)

    framing = measure_framing(rows, np.ones_like(rows))
    predicted = predict_one_sided((near, far), height, (up, across), turn, 0.0)
    assert framing is not None
    assert predicted == pytest.approx(framing.left_only, abs=0.01)
    assert framing.right_only == 0

    level = predict_one_sided((near, far), height, (up, across), 0.0, 0.0)
    wide = predict_one_sided((near, far + 4), height, (up, across), 0.0, 0.0)
    assert wide > level
    assert predict_one_sided((5.0, 5.0), height, (up, across), 0.0, 0.0) == 0
    assert predict_one_sided((near, far), height, (up, across), 0.0, -up - 0.1) == 0


def test_worlds_are_selected_by_kind_and_side_of_traffic(tmp_path: Path) -> None:
    (tmp_path / "truth").mkdir()
    sides = {"40000_town_sun": "right", "40001_townrain_dusk": "left", "40006_robot_sun": "left"}
    for name in sides:
        (tmp_path / "truth" / f"{name}.png").touch()
    rows = [f"{name},{side}" for name, side in sides.items()]
    (tmp_path / "worlds.csv").write_text("\n".join(["name,traffic", *rows]))

    towns = ["40000_town_sun", "40001_townrain_dusk"]
    assert select_worlds(tmp_path, "town", "") == towns
    assert select_worlds(tmp_path, "town", "left") == towns[1:]
    assert select_worlds(tmp_path, "", "left") == [*towns[1:], "40006_robot_sun"]
