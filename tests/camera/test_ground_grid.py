"""The grid: walls at known places, what is behind them, and what is not seen."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.camera.ground import GroundCamera, lens_of_view, mounted
from roadtorch.camera.ground_grid import FREE, OCCUPIED, UNKNOWN, Grid, GridSettings, ground_grid

WIDTH, HEIGHT = 240, 180
CAMERA = GroundCamera(lens_of_view(WIDTH, HEIGHT, 60), mounted(1.4, 12))
SETTINGS = GridSettings(resolution=0.2, range=16, side=6)


def picture_of(inside: str | None = None, camera: GroundCamera = CAMERA) -> Tensor:
    """A mask bool (H,W): ground but what ``inside`` (of x and y, metres) says; no sky."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    ground = camera.ground_of(np.stack([columns.ravel(), rows.ravel()], 1).astype(float))
    x, y = ground.T
    road = np.isfinite(x)
    if inside is not None:
        road &= ~eval(inside, {"x": x, "y": y, "np": np})
    return torch.from_numpy(road.reshape(HEIGHT, WIDTH))


def cell(grid: Grid, x: float, y: float) -> int:
    """The value of the cell at a point, metres."""
    column = math.floor((x - grid.origin[0]) / grid.resolution)
    row = math.floor((y - grid.origin[1]) / grid.resolution)
    return int(grid.cells[row, column])


def test_free_ground_is_free_in_the_view_and_unknown_outside() -> None:
    grid = ground_grid(picture_of(), CAMERA, SETTINGS)

    assert grid.cells.shape == (60, 80)
    assert grid.origin == (0, -6)
    assert cell(grid, 8, 0) == FREE
    assert cell(grid, 0.5, 0) == cell(grid, 2, 5) == UNKNOWN  # below and beside the picture
    assert (grid.cells == OCCUPIED).sum() == 0
    assert grid.likelihood.isnan().equal(grid.cells == UNKNOWN)


def test_a_wall_is_occupied_and_unknown_behind() -> None:
    grid = ground_grid(picture_of("(x > 9) & (y > 0)"), CAMERA, SETTINGS)

    assert cell(grid, 8.5, 1) == cell(grid, 12, -2) == FREE
    assert all((grid.cells[row, 44:47] == OCCUPIED).any() for row in range(32, 45))  # a row: .3 m
    assert cell(grid, 9.5, 1) == cell(grid, 14, 3) == UNKNOWN
    assert OCCUPIED not in grid.cells[:29]


def test_left_is_left_and_the_order_that_of_an_occupancy_grid() -> None:
    grid = ground_grid(picture_of("y > 1"), CAMERA, SETTINGS)

    assert cell(grid, 8, 0) == cell(grid, 8, -2) == FREE
    assert cell(grid, 8, 2.5) == UNKNOWN
    assert OCCUPIED in [cell(grid, 8, y) for y in (0.9, 1.1)]
    assert grid.occupancy.dtype == torch.int8
    assert grid.occupancy[35 * 80 + 40] == cell(grid, 40.5 * 0.2, 35.5 * 0.2 - 6)


def test_the_shadow_of_a_box_is_unknown_and_its_sides_are_no_walls() -> None:
    grid = ground_grid(picture_of("(x > 5) & (x < 6) & (abs(y) < .5)"), CAMERA, SETTINGS)

    assert cell(grid, 5.1, 0) == OCCUPIED
    assert cell(grid, 10, 0) == UNKNOWN  # road is seen there, over the box's smear
    assert cell(grid, 10, 2) == FREE
    assert OCCUPIED not in grid.cells[:, 40:]  # behind x = 8


def test_the_edge_of_a_road_has_no_gaps() -> None:
    grid = ground_grid(picture_of("abs(y) > 2"), CAMERA, SETTINGS)

    for column in range(30, 60):
        assert (grid.cells[38:42, column] == OCCUPIED).any(), column
        assert (grid.cells[18:22, column] == OCCUPIED).any(), column


def test_the_ego_car_is_unknown_and_hides_nothing() -> None:
    ego = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    ego[-40:] = True
    road = picture_of() & ~ego

    grid = ground_grid(road, CAMERA, SETTINGS, ego)

    assert (grid.cells == OCCUPIED).sum() == 0
    assert cell(grid, 9, 0) == FREE
    assert cell(grid, 2.6, 0) == UNKNOWN
    assert cell(ground_grid(picture_of(), CAMERA, SETTINGS), 2.6, 0) == FREE


def test_far_cells_are_unknown_where_a_pixel_covers_too_many() -> None:
    fine = GridSettings(resolution=0.2, range=16, side=6, coarsest=1)

    grid = ground_grid(picture_of(), CAMERA, fine)

    assert cell(grid, 4, 0) == FREE
    assert cell(grid, 15, 0) == UNKNOWN
    reach = math.sqrt(0.2 * CAMERA.lens.focal_x * 1.4)  # a pixel is r² / (f h) long
    assert cell(grid, reach - 1, 0) == FREE
    assert cell(grid, reach + 1.5, 0) == UNKNOWN


def test_a_cell_takes_the_mean_of_its_pixels_and_is_road_from_a_threshold_on() -> None:
    dotted, road = picture_of().float(), picture_of().float() * 0.4
    dotted[::3, ::3] = 0  # a ninth of the pixels
    low = SETTINGS.model_copy(update={"threshold": 0.3})

    grid = ground_grid(dotted, CAMERA, GridSettings(resolution=0.5, range=8, side=3))

    assert grid.likelihood[5:7, 6:9].numpy() == pytest.approx(8 / 9, abs=0.06)
    assert cell(ground_grid(road, CAMERA, low), 8, 0) == FREE
    assert cell(ground_grid(road, CAMERA, SETTINGS), 8, 0) == UNKNOWN


def test_a_mount_moves_the_grid_with_the_camera() -> None:
    camera = GroundCamera(CAMERA.lens, mounted(1.4, 12, mount=(0.6, -0.4)))
    moved = ground_grid(picture_of("x > 9.6", camera), camera, SETTINGS)

    assert moved.origin == pytest.approx((0.6, -6.4))
    assert cell(moved, 9.1, -0.4) == FREE
    assert OCCUPIED in [cell(moved, x, -0.4) for x in (9.5, 9.7, 9.9)]


def test_a_steep_camera_sees_its_own_foot() -> None:
    camera, near = GroundCamera(CAMERA.lens, mounted(1.4, 80)), {"range": 2, "side": 1}
    everywhere = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)

    grid = ground_grid(everywhere, camera, GridSettings(resolution=0.05, **near))

    assert cell(grid, 0.1, 0) == cell(grid, 0.1, 0.4) == FREE


def test_sky_alone_and_wrong_sizes_are_refused() -> None:
    up = GroundCamera(CAMERA.lens, mounted(1.4, -30))
    with pytest.raises(InputError, match="shows no ground"):
        ground_grid(picture_of(), up, SETTINGS)
    with pytest.raises(InputError, match="is 5×4 pixels, the lens 240×180"):
        ground_grid(torch.ones(4, 5), CAMERA, SETTINGS)
