"""Rendered worlds without Blender: plans, tables, lenses, truth, development, lists of a pack."""

import csv
import subprocess
import sys
import tomllib
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from random import Random

import cv2
import numpy as np
import pytest

from roadtorch.camera.ground import Lens, project_rays
from roadtorch.train.source import HELD_OUT
from train.worlds import lens as lenses
from train.worlds.pack import append_row, compare_with_list, draw_sheet, read_list
from train.worlds.plans import (
    FISHEYES,
    RIDERS,
    ROADLESS,
    SCHEDULE,
    plan_world,
)
from train.worlds.sensor import Exposure, blur_by_motion, develop
from train.worlds.tables import parse_cell, read_column, read_table
from train.worlds.truth import EGO, HORIZONTAL, ROAD, VERTICAL, VOID, settle_truth


@pytest.mark.parametrize("first", [50000, 50017, 50005 + HELD_OUT])
def test_any_hundred_numbers_are_balanced(first: int) -> None:
    plans = [plan_world(number) for number in range(first, first + 100)]
    names, mounts = Counter(plan.name for plan in plans), Counter(plan.mount for plan in plans)

    assert len(SCHEDULE) == 100
    assert (names["wetnight"], names["plaza"], names["setts"]) == (3, 2, 2)
    assert names["fisheyefront"] == names["fisheyerear"] == names["fisheyeside"] / 2 == 2
    assert [mounts[mount] for mount in (*FISHEYES, *RIDERS)] == [2, 2, 2, 2, 4, 2]
    assert Counter(plan.hand for plan in plans) == {1: 52, -1: 48}
    assert sum(set(plan.ground) == set(ROADLESS) for plan in plans) == 2
    assert sum(plan.light == {"night": 1} for plan in plans) == 10


def test_tables_name_only_what_there_is() -> None:
    kinds, colours = {row["kind"] for row in read_table("kinds")}, read_column("colours", "percent")
    things = {row["thing"] for row in read_table("things")} | {"child"}
    shapes = set(["box", "ball", "limb", "wheel", "tyre", "disc", "extrude", "turned"])
    assert [parse_cell(text) for text in ("a=.5", "0:-.8", "3")] == [{"a": 0.5}, (0, -0.8), 3]

    assert {name for plan in SCHEDULE for name in plan.ground} <= kinds | set(ROADLESS)
    assert {row["shape"].rstrip("±") for row in read_table("things")} <= shapes | things
    assert {row["truth"] for row in read_table("strips")} <= {HORIZONTAL, VOID}
    tones = " ".join(str(row["colours"]) for row in read_table("strips")).split()
    assert set(tones) | set(read_column("weights", "weights")["seasons"]) <= set(colours)
    for name, weights in read_column("weights", "weights").items():
        if name.split()[0] in ("people", "obstacles", "posts", "vehicles"):
            assert set(weights) <= things


@pytest.mark.parametrize("seed", range(12))
def test_a_sampled_fisheye_is_the_lens_that_is_written(seed: int) -> None:
    fisheye = lenses.sample_fisheye(Random(seed), 384, 288)
    table = tomllib.loads(lenses.write_lens(fisheye, {"pitch": 30.0}))
    mount = table.pop("mount")
    lens = Lens(**{**table, "coefficients": tuple(table["coefficients"])})
    angles = np.linspace(0.05, np.radians(fisheye.view / 2), 7)
    radii = lenses.bend_rays(angles, fisheye.coefficients)

    pixels, _ = project_rays(lens, np.stack([np.sin(angles), np.zeros(7), np.cos(angles)], 1))
    assert pixels[:, 0] == pytest.approx(fisheye.centre_x + fisheye.focal_x * radii, abs=0.01)
    assert mount["view"] == pytest.approx(fisheye.view, abs=0.01)

    millimetres = radii * fisheye.focal_x / fisheye.width * lenses.SENSOR
    weights = lenses.angle_polynomial(fisheye)
    fitted = sum(weight * millimetres**k for k, weight in enumerate(weights))
    assert np.abs(fitted - angles).max() * fisheye.focal_x < 0.3  # pixels


def test_beyond_the_circle_of_a_fisheye_the_image_is_black_and_void() -> None:
    fisheye = lenses.sample_fisheye(Random(3), 96, 72)._replace(focal_x=20.0, focal_y=20.0)
    circle = lenses.image_circle(fisheye)
    light, truth = np.ones((72, 96, 3), np.float32), np.full((72, 96), ROAD, np.uint8)
    photo = develop(light, truth, Exposure("sun", circle=circle), np.random.default_rng(0))
    assert (photo.truth == np.where(circle, ROAD, VOID)).all()
    assert photo.image[:4, :4].max() < 60 < photo.image[30:40, 40:50].min()


def test_speed_blurs_the_world_and_not_what_carries_the_camera() -> None:
    stripes = np.tile(np.array([0.1, 0.9], np.float32), (96, 64))[..., None].repeat(3, 2)
    truth = np.full((96, 128), ROAD, np.uint8)
    truth[64:] = EGO
    blurred = blur_by_motion(stripes, truth, 1.0, np.random.default_rng(1))
    contrast = np.abs(np.diff(blurred, axis=1)).mean((1, 2))
    assert contrast[10:50].mean() < 0.3
    assert contrast[75:90].mean() == pytest.approx(0.8, abs=0.05)


def test_a_pixel_is_vertical_from_a_third_on() -> None:
    points = np.full((3, 9), ROAD, np.uint8)
    points[:, 1] = VERTICAL  # a post of a third of a pixel
    points[:2, 4] = VERTICAL  # less
    points[:, 6:8] = HORIZONTAL
    assert settle_truth(points, 3).tolist() == [[VERTICAL, ROAD, HORIZONTAL]]


def test_a_pack_is_compared_with_a_list(tmp_path: Path) -> None:
    for folder in ("images", "truth"):
        (tmp_path / folder).mkdir()
    truth = np.full((6, 8), ROAD, np.uint8)
    for name in ("50000_town_sun", "50001_wetnight_night", "50002_motorcycle_dusk"):
        cv2.imwrite(str(tmp_path / "truth" / f"{name}.png"), truth)
        cv2.imwrite(str(tmp_path / "images" / f"{name}.jpg"), truth)
        append_row(tmp_path, name, truth)
    table = tmp_path / "worlds.csv"
    rows = list(csv.DictReader(table.read_text().splitlines()))

    assert [*read_list(table)] == [row["name"] for row in rows]
    assert compare_with_list(tmp_path, table) == ([], [])
    assert [(row["kind"], row["light"]) for row in rows][1] == ("wetnight", "night")
    assert draw_sheet(tmp_path, range(50000, 50003), 2).shape == (24, 16, 3)

    (tmp_path / "images" / f"{rows[0]['name']}.jpg").unlink()
    truth[0, 0] = VOID
    cv2.imwrite(str(tmp_path / "truth" / f"{rows[2]['name']}.png"), truth)
    assert compare_with_list(tmp_path, table) == ([rows[0]["name"]], [rows[2]["name"]])


@pytest.mark.skipif(find_spec("bpy") is None, reason="needs Blender's module, bpy 5.0.1")
def test_a_number_gives_the_same_truth_twice(tmp_path: Path) -> None:
    command, table = [sys.executable, "-m", "train.worlds"], tmp_path / "first" / "worlds.csv"
    for folder, numbers in (("first", ("50000", "50001")), ("second", ("--list", table))):
        subprocess.run([*command, *numbers, "--out", tmp_path / folder], check=True)

    check = subprocess.run([*command, "--check", table, "--out", tmp_path / "second"])
    assert check.returncode == 0
