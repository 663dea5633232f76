"""Camera over flat ground, and the grid."""

import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import read_image
from roadtorch.base.settings import build_settings
from roadtorch.camera.ground import (
    GroundCamera,
    Lens,
    camera_pose,
    pinhole_lens,
    pitch_from_horizon,
    pixel_rays,
    project_rays,
)
from roadtorch.camera.ground_grid import FREE, OCCUPIED, UNKNOWN, Grid, GridSettings, ground_grid
from roadtorch.camera.ground_points import ground_points
from roadtorch.camera.mounting import PitchFilter
from roadtorch.detectors.catalogue import load_detector
from roadtorch.run.writers.bag import MASK_CLASS_NAMES
from tests.reference.semantic_layer import NAV2_PARAMETERS, count_stray_cells, mark_cells

LENS = pinhole_lens(640, 480, 60)
DISTORTIONS = {
    "plumb_bob": (-0.3, 0.1, 0.001, -0.001, 0.0),
    "rational_polynomial": (0.1, 0.2, 0.0, 0.0, 0.01, 0.3, 0.1, 0.02),
    "equidistant": (0.05, -0.01, 0.001, 0.0),
}


def ground(*points: tuple[float, float]) -> np.ndarray:
    return np.array([[x, y, 0.0] for x, y in points])


def distorted_lens(model: str) -> Lens:
    values = {**LENS.model_dump(), "model": model, "coefficients": DISTORTIONS[model]}
    return build_settings(Lens, values)


def unproject_to_ground(camera: GroundCamera, pixels: np.ndarray) -> np.ndarray:
    """Return the ground points (n, 2), metres, of pixels (n, 2); NaN at and above the horizon."""
    rays = camera.unproject(pixels)
    far = camera.pose.position[2] / np.where(rays[:, 2] < -1e-6, -rays[:, 2], np.nan)
    return np.array(camera.pose.position[:2]) + far[:, None] * rays[:, :2]


def test_a_level_camera_by_hand() -> None:
    camera = GroundCamera(LENS, camera_pose(1.4, 0))

    pixels, inside = camera.project(ground((10, 0), (10, 2), (-10, 0), (1, 0)))

    assert pixels[0] == pytest.approx([319.5, 239.5 + LENS.focal_x * 0.14])
    assert pixels[1, 0] == pytest.approx(319.5 - LENS.focal_x * 0.2)  # left is left
    assert inside.tolist() == [True, True, False, False]
    sky = np.array([[300.0, 100.0], [300.0, 239.5]])
    assert np.isnan(unproject_to_ground(camera, sky)).all()
    # A lower right side lifts the horizon there.
    rolled = GroundCamera(LENS, camera_pose(1.4, 0, roll=10))
    right_ray, left_ray = rolled.unproject(np.array([[600.0, 239.5], [40.0, 239.5]]))
    assert right_ray[2] < 0 < left_ray[2]


@given(pitch=st.floats(-10, 60), roll=st.floats(-20, 20), x=st.floats(2, 30), y=st.floats(-5, 5))
def test_pixels_come_back_to_their_ground(pitch: float, roll: float, x: float, y: float) -> None:
    camera = GroundCamera(LENS, camera_pose(1.4, pitch, roll, (0.5, -0.2)))
    pixels, inside = camera.project(ground((x, y)))

    if inside.all():
        assert unproject_to_ground(camera, pixels)[0] == pytest.approx([x, y], abs=1e-6)


def opencv_pixels(lens: Lens, rays: np.ndarray) -> np.ndarray:
    """Return the pixels (n, 2) of rays (n, 3) by OpenCV."""
    project = cv2.fisheye.projectPoints if lens.model == "equidistant" else cv2.projectPoints
    zeros, coefficients = np.zeros(3), np.array(lens.coefficients)
    return project(rays[:, None], zeros, zeros, lens.matrix, coefficients)[0][:, 0]


@pytest.mark.parametrize("model", DISTORTIONS)
def test_distortion_is_undone_and_distorted_ground_comes_back(model: str) -> None:
    camera = GroundCamera(distorted_lens(model), camera_pose(1.4, 10))
    pixels = np.random.default_rng(0).uniform(0, 479, (500, 2))
    points = ground((5, 1), (8, -2), (20, 3))

    projected, inside = camera.project(points)

    rays = pixel_rays(camera.lens, pixels)
    assert np.abs(project_rays(camera.lens, rays)[0] - pixels).max() < 1e-3
    expected = opencv_pixels(camera.lens, rays)
    assert project_rays(camera.lens, 7 * rays)[0] == pytest.approx(expected, abs=1e-3)
    assert inside.all()
    assert unproject_to_ground(camera, projected) == pytest.approx(points[:, :2], abs=1e-4)


def test_distortion_that_turns_back_shows_nothing() -> None:
    camera = GroundCamera(distorted_lens("plumb_bob"), camera_pose(1.4, 60))
    wide = ground((0.9, 3.0))  # 70 degrees off the axis, where the polynomial has turned

    pixels, inside = camera.project(wide)

    assert not inside.any()
    assert np.isfinite(pixels).all()


@given(pitch=st.floats(-8, 8), roll=st.floats(-30, 30))
def test_the_horizon_gives_the_pitch(pitch: float, roll: float) -> None:
    level = math.tan(math.radians(pitch)) / math.cos(math.radians(roll))
    row = (239.5 - LENS.focal_y * level + 0.5) / 480

    assert pitch_from_horizon(LENS, row, roll) == pytest.approx(pitch, abs=1e-9)


def test_the_pitch_of_a_live_camera_follows_the_median_and_ignores_jitter() -> None:
    pitch_filter = PitchFilter()

    jitter = [pitch_filter(5 + 0.1 * (-1) ** number) for number in range(20)]
    outlier = pitch_filter(12)
    slope = [pitch_filter(8) for _ in range(9)]

    assert {*jitter, outlier} == {jitter[0]}
    assert slope[-1] == 8


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda: pitch_from_horizon(LENS, 1.2), "horizon: 1.2 lies outside the image"),
        (lambda: build_settings(Lens, {**LENS.model_dump(), "model": "plumb_bob"}), "coefficients"),
        (lambda: LENS.at(640, 360), "is 640×360 pixels, the calibration 640×480"),
        (lambda: ground_grid(draw_mask(), UP, SETTINGS), "shows no ground"),
        (lambda: ground_grid(torch.ones(4, 5), CAMERA, SETTINGS), "is 5×4 pixels, the lens 240"),
    ],
)
def test_impossible_cameras_are_refused(call: Callable[[], object], problem: str) -> None:
    with pytest.raises((ConfigError, InputError), match=problem):
        call()


# --- the grid ---------------------------------------------------------------------------


WIDTH, HEIGHT = 240, 180
CAMERA = GroundCamera(pinhole_lens(WIDTH, HEIGHT, 60), camera_pose(1.4, 12))
UP = GroundCamera(CAMERA.lens, camera_pose(1.4, -30))
SETTINGS = GridSettings(cell=0.2, range=16, side=6)


def ground_of_pixels(camera: GroundCamera) -> np.ndarray:
    """Return x and y (2, H, W) of the ground that the pixels show; NaN above the horizon."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    pixels = np.stack([columns.ravel(), rows.ravel()], 1).astype(float)
    return unproject_to_ground(camera, pixels).T.reshape(2, HEIGHT, WIDTH)


def draw_mask(inside: str | None = None, camera: GroundCamera = CAMERA) -> Tensor:
    """Return a mask bool (H, W) of the ground where ``inside`` (of x, y, metres) is false."""
    x, y = ground_of_pixels(camera)
    road = np.isfinite(x)
    if inside is not None:
        road &= ~eval(inside, {"x": x, "y": y, "np": np})
    return torch.from_numpy(road)


def cell(grid: Grid, x: float, y: float) -> int:
    """Return the value of the cell at a point, metres."""
    column = math.floor((x - grid.origin[0]) / grid.resolution)
    row = math.floor((y - grid.origin[1]) / grid.resolution)
    return int(grid.cells[row, column])


EGO = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
EGO[-40:] = True
REACH = math.sqrt(0.2 * CAMERA.lens.focal_x * 1.4)  # a pixel is r² / (f h) metres long


@pytest.mark.parametrize(
    ("inside", "more", "cells"),
    [
        # Free in the view, unknown below and beside it.
        (None, {}, {FREE: [(8, 0), (2.6, 0)], UNKNOWN: [(0.5, 0), (2, 5)]}),
        # A wall is unknown behind; left is left.
        ("(x > 9) & (y > 0)", {}, {FREE: [(8.5, 1), (12, -2)], UNKNOWN: [(9.5, 1), (14, 3)]}),
        ("y > 1", {}, {FREE: [(8, 0), (8, -2)], UNKNOWN: [(8, 2.5)]}),
        # Behind a box road is seen, over the box's smear.
        (
            "(x > 5) & (x < 6) & (abs(y) < .5)",
            {},
            {OCCUPIED: [(5.1, 0)], UNKNOWN: [(10, 0)], FREE: [(10, 2)]},
        ),
        # Where a pixel covers too many cells.
        (
            None,
            {"max_cells_per_pixel": 1},
            {FREE: [(4, 0), (REACH - 1, 0)], UNKNOWN: [(15, 0), (REACH + 1.5, 0)]},
        ),
    ],
)
def test_cells_are_free_occupied_or_unknown(
    inside: str | None, more: dict[str, float], cells: dict[int, list[tuple[float, float]]]
) -> None:
    settings = SETTINGS.model_copy(update=more)

    grid = ground_grid(draw_mask(inside), CAMERA, settings)

    assert (grid.cells.shape, grid.origin) == ((60, 80), (0, -6))
    for value, points in cells.items():
        assert [cell(grid, *point) for point in points] == [value] * len(points)
    if inside is None:
        assert OCCUPIED not in grid.cells
        assert grid.likelihood.isnan().equal(grid.cells == UNKNOWN)


def test_a_bonnets_edge_hides_no_road_and_a_wall_behind_it_does() -> None:
    edge, wall = draw_mask(), draw_mask()
    edge[-43:], wall[:-42] = False, False

    free, behind_edge, behind_wall = (
        ground_grid(road, CAMERA, SETTINGS, EGO) for road in (draw_mask(), edge, wall)
    )

    area = [(grid.cells == FREE).sum() for grid in (free, behind_edge, behind_wall)]
    assert area[1] > 0.9 * area[0] > 0 == free.blocked == behind_edge.blocked
    assert OCCUPIED not in behind_edge.cells
    assert area[2] < 0.1 * area[0]
    assert OCCUPIED in behind_wall.cells


@pytest.mark.data
def test_the_motorway_is_free_behind_an_estimated_bonnet(data_root: Path) -> None:
    files = sorted((data_root / "unlabelled_free").glob("udhwy_00[0-3]*.jpg"))[::13]
    estimated, by_hand = load_detector("fusion"), load_detector("fusion", ego={"bottom": 0.11})

    for file in files:
        image = read_image(file)
        areas = []
        for detection in (estimated.detect(image), by_hand.detect(image)):
            lens = pinhole_lens(image.shape[2], image.shape[1], 77)
            camera = GroundCamera(lens, camera_pose(1.3, pitch_from_horizon(lens, 0.6)))
            road = detection.likelihood * detection.mask
            grid = ground_grid(road, camera, GridSettings(), detection.cues.get("ego"))
            areas.append(float((grid.cells == FREE).sum()))
        assert areas[0] == pytest.approx(areas[1], rel=0.2)


def test_walls_have_no_gaps_and_shadows_no_walls() -> None:
    ahead, sides, box = (
        ground_grid(draw_mask(inside), CAMERA, SETTINGS).cells == OCCUPIED
        for inside in ("(x > 9) & (y > 0)", "abs(y) > 2", "(x > 5) & (x < 6) & (abs(y) < .5)")
    )

    assert ahead[32:45, 44:47].any(1).all()  # a row: .3 m
    assert not ahead[:29].any()
    for rows in (slice(38, 42), slice(18, 22)):
        assert sides[rows, 30:60].any(0).all()
    assert not box[:, 40:].any()  # behind x = 8


def test_the_order_is_that_of_an_occupancy_grid() -> None:
    grid = ground_grid(draw_mask("y > 1"), CAMERA, SETTINGS)

    assert grid.occupancy.dtype == torch.int8
    assert grid.occupancy[35 * 80 + 40] == cell(grid, 40.5 * 0.2, 35.5 * 0.2 - 6)


def test_a_cell_takes_the_mean_of_its_pixels_and_is_road_from_a_threshold_on() -> None:
    dotted, road = draw_mask().float(), draw_mask().float() * 0.4
    dotted[::3, ::3] = 0  # a ninth of the pixels

    grid = ground_grid(dotted, CAMERA, GridSettings(cell=0.5, range=8, side=3))

    assert grid.likelihood[5:7, 6:9].numpy() == pytest.approx(8 / 9, abs=0.06)
    assert cell(ground_grid(road, CAMERA, SETTINGS, threshold=0.3), 8, 0) == FREE
    assert cell(ground_grid(road, CAMERA, SETTINGS), 8, 0) == UNKNOWN


def test_a_mount_moves_the_grid_with_the_camera() -> None:
    camera = GroundCamera(CAMERA.lens, camera_pose(1.4, 12, mount=(0.6, -0.4)))
    moved = ground_grid(draw_mask("x > 9.6", camera), camera, SETTINGS)

    assert moved.origin == pytest.approx((0.6, -6.4))
    assert cell(moved, 9.1, -0.4) == FREE
    assert OCCUPIED in [cell(moved, x, -0.4) for x in (9.5, 9.7, 9.9)]


# --- ground points ----------------------------------------------------------------------


SCENES = {
    "a road with sides": "abs(y) > 2",
    "a wall ahead": "x > 3.5",
    "a box on the road": "(abs(y) > 2) | (x > 3) & (x < 3.6) & (abs(y) < .5)",
    "a bend": "abs(y - x * x / 20) > 1.5",
}


def wide_camera(model: str, pitch: float = 15.0, roll: float = 0.0) -> GroundCamera:
    values = pinhole_lens(WIDTH, HEIGHT, 70).model_dump()
    if model in DISTORTIONS:
        values |= {"model": model, "coefficients": DISTORTIONS[model]}
    return GroundCamera(build_settings(Lens, values), camera_pose(1.2, pitch, roll))


@pytest.mark.parametrize("model", ["pinhole", *DISTORTIONS])
@pytest.mark.parametrize(("pitch", "roll"), [(15, 0), (0, 0), (-3, 8), (60, -5)])
def test_points_lie_on_the_ground_below_their_pixels(model: str, pitch: float, roll: float) -> None:
    camera = wide_camera(model, pitch, roll)
    everywhere = Grid(torch.zeros(60, 80, dtype=torch.int8), torch.zeros(60, 80), 0.2, (0, -6))

    points = ground_points(camera, everywhere)

    x, y = ground_of_pixels(camera)
    finite = np.isfinite(points).all(-1)
    assert (finite == ((x >= 0) & (x < 16) & (abs(y) < 6))).mean() > 0.999  # but for rounding
    robot = points[finite] @ np.array(camera.pose.axes) + camera.pose.position
    assert np.abs(robot - ground(*zip(x[finite], y[finite], strict=True))).max() < 1e-3


@pytest.mark.parametrize("model", ["pinhole", *DISTORTIONS])
@pytest.mark.parametrize("scene", SCENES)
def test_nav2_marks_the_cells_of_the_grid(model: str, scene: str) -> None:
    camera = wide_camera(model)
    mask = draw_mask(SCENES[scene], camera)
    grid = ground_grid(mask, camera, SETTINGS)
    reach = math.sqrt(0.2 * camera.lens.focal_y * 1.2)  # a pixel is r² / (f h) metres long
    layer = NAV2_PARAMETERS | {"max_obstacle_distance": reach}
    confidence = np.full(mask.shape, 255, np.uint8)

    points = ground_points(camera, grid)
    names = MASK_CLASS_NAMES
    marked = mark_cells(mask.numpy(), confidence, points, names, layer, camera.pose, SETTINGS)

    assert min((marked == 0).sum(), (marked == 254).sum()) > 20
    assert count_stray_cells(marked, grid.cells.numpy(), SETTINGS, reach - 0.5) == 0


@pytest.mark.parametrize("distance", [3.5, 5.5, 9.0, 12.0])
def test_a_wall_keeps_its_first_point_in_every_column_and_no_other(distance: float) -> None:
    camera = wide_camera("pinhole")
    mask = draw_mask(f"x > {distance}", camera)

    points = ground_points(camera, ground_grid(mask, camera, SETTINGS))[:, 80:160]

    wall = np.isfinite(points[..., 2]) & ~mask.numpy()[:, 80:160]
    first = mask.numpy().argmax(0)[80:160] - 1  # the row above the uppermost of the road
    assert wall[first, range(80)].all()
    length = np.square(distance + 0.5) / camera.lens.focal_y / 1.2  # of a pixel on the ground
    assert ground_of_pixels(camera)[0][:, 80:160][wall].max() < distance + length + 0.4  # two cells


def test_pixels_outside_a_fisheye_circle_have_no_point() -> None:
    lens = wide_camera("equidistant").lens.model_copy(update={"field_of_view": 50.0})
    camera = GroundCamera(lens, camera_pose(1.2, 30))

    finite = np.isfinite(ground_points(camera, ground_grid(draw_mask(), camera, SETTINGS))[..., 2])

    assert (finite[130, WIDTH // 2], finite[130, 20]) == (True, False)
