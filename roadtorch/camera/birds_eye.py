"""KITTI's bird's-eye view: maps of an image on the road plane, 800×400 cells of 5 cm.

Fritsch, Kuehnl, Geiger, "A New Performance Measure and Evaluation Benchmark for Road Detection
Algorithms" (ITSC 2013), and the benchmark's development kit of 2015: each rounding below is the
kit's, so that every cell and pixel is the same.

Coordinates come in pairs. Road: x metres to the right, z metres ahead, on the plane y = 0.
Image: u to the right, v down, in pixels counted from one, as in the kit. Cells and pixels: row and
column, counted from zero; cell row 0 is far, cell column 0 is left.
"""

from functools import lru_cache

import torch
from torch import Tensor

from roadtorch.camera.calibration import Calibration, road_homography

BEV_ROWS, BEV_COLUMNS = 800, 400

CELL_SIZE = 0.05  # metres
LEFT_EDGE, FAR_EDGE = -10.0, 46.0  # metres; the right edge is at 10, the near one at 6

_Pair = tuple[Tensor, Tensor]

# --- points -----------------------------------------------------------------------------


def transform_points(homography: Tensor, x: Tensor, y: Tensor) -> _Pair:
    """Transform points by a homography (3, 3); float64, of the common shape of x and y.

    A point at infinity becomes infinite or NaN. Points behind the camera are projected like any
    other: the kit does not test for them, and its cells are all in front.
    """
    # Not a matrix product, whose rounding differs between machines and would move cells.
    u, v, scale = (a * x + b * y + c for a, b, c in homography.tolist())
    return u / scale, v / scale


def cell_centres(row: Tensor, column: Tensor) -> _Pair:
    """Return the centres (x, z) of cells, float64, rounded to float32 as in the kit."""
    x = LEFT_EDGE + (column.double() + 0.5) * CELL_SIZE
    z = FAR_EDGE - (row.double() + 0.5) * CELL_SIZE
    return x.float().double(), z.float().double()


# --- maps -------------------------------------------------------------------------------


@lru_cache(maxsize=4)  # 3 MB each; the maps of one image come one after the other
def cell_pixels(calibration: Calibration, height: int, width: int) -> _Pair:
    """Return each cell's pixel, flat index int64 (800, 400), and bool of the cells that have one.

    These are the submitted and scored cells. A cell has a pixel where 1 ≤ u ≤ width and
    1 ≤ v ≤ height: the nearest lower one, counted from one by the kit. Sampling takes single
    pixels, so thresholds and rounding may come before or after it. Cached: do not change it.
    """
    cells = torch.arange(BEV_ROWS)[:, None], torch.arange(BEV_COLUMNS)[None]
    u, v = transform_points(road_homography(calibration), *cell_centres(*cells))
    inside = (u >= 1) & (u <= width) & (v >= 1) & (v <= height)
    index = torch.where(inside, (v.floor() - 1) * width + u.floor() - 1, 0)  # NaN is no integer
    return index.long(), inside


def warp_to_birds_eye(values: Tensor, calibration: Calibration) -> Tensor:
    """Warp values (..., H, W) to (..., 800, 400), same dtype; 0 where no pixel shows the cell."""
    height, width = values.shape[-2:]
    index, inside = (part.to(values.device) for part in cell_pixels(calibration, height, width))
    cells = values.flatten(-2).index_select(-1, index.flatten())
    return cells.unflatten(-1, index.shape).masked_fill(~inside, 0)
