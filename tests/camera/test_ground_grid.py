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
            {"coarsest": 1},
            {FREE: [(4, 0), (REACH - 1, 0)], UNKNOWN: [(15, 0), (REACH + 1.5, 0)]},
        ),
    ],
)
def test_cells_are_free_occupied_or_unknown(
    inside: str | None, more: dict[str, float], cells: dict[int, list[tuple[float, float]]]
) -> None:
    settings = SETTINGS.model_copy(update=more)

    grid = ground_grid(picture_of(inside), CAMERA, settings)

    assert (grid.cells.shape, grid.origin) == ((60, 80), (0, -6))
    for value, points in cells.items():
        assert [cell(grid, *point) for point in points] == [value] * len(points)
    if inside is None:
        assert OCCUPIED not in grid.cells
        assert grid.likelihood.isnan().equal(grid.cells == UNKNOWN)


def test_walls_have_no_gaps_and_shadows_no_walls() -> None:
    ahead, beside, box = (
        ground_grid(picture_of(inside), CAMERA, SETTINGS).cells == OCCUPIED
        for inside in ("(x > 9) & (y > 0)", "abs(y) > 2", "(x > 5) & (x < 6) & (abs(y) < .5)")
    )

    assert ahead[32:45, 44:47].any(1).all()  # a row: .3 m
    assert not ahead[:29].any()
    for rows in (slice(38, 42), slice(18, 22)):
        assert beside[rows, 30:60].any(0).all()
    assert not box[:, 40:].any()  # behind x = 8


def test_the_order_is_that_of_an_occupancy_grid() -> None:
    grid = ground_grid(picture_of("y > 1"), CAMERA, SETTINGS)

    assert grid.occupancy.dtype == torch.int8
    assert grid.occupancy[35 * 80 + 40] == cell(grid, 40.5 * 0.2, 35.5 * 0.2 - 6)


def test_the_ego_car_is_unknown_and_hides_nothing() -> None:
    grid = ground_grid(picture_of() & ~EGO, CAMERA, SETTINGS, EGO)

    assert OCCUPIED not in grid.cells
    assert (cell(grid, 9, 0), cell(grid, 2.6, 0)) == (FREE, UNKNOWN)


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


def test_sky_alone_and_wrong_sizes_are_refused() -> None:
    up = GroundCamera(CAMERA.lens, mounted(1.4, -30))
    with pytest.raises(InputError, match="shows no ground"):
        ground_grid(picture_of(), up, SETTINGS)
    with pytest.raises(InputError, match="is 5×4 pixels, the lens 240×180"):
        ground_grid(torch.ones(4, 5), CAMERA, SETTINGS)
