"""KITTI's bird's-eye view: maps between a picture and the road plane, 800×400 cells of 5 cm.

Fritsch, Kuehnl, Geiger, "A New Performance Measure and Evaluation Benchmark for Road
Detection Algorithms" (ITSC 2013), and what the benchmark's development kit of 2015 does
with it: each rounding below is the kit's, so that every cell and pixel is the same.

Coordinates come in pairs. Road: x metres to the right, z metres ahead, on the plane y = 0.
Image: u to the right, v down, in pixels counted from ONE, as the kit reads them. Cells and
pixels: row and column, counted from zero; cell row 0 is far, cell column 0 is left.
"""

from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from roadtorch.camera.calibration import Calibration, image_to_road, road_to_image

ROWS, COLUMNS = 800, 400

CELL = 0.05  # metres

LEFT, NEAR, FAR = -10.0, 6.0, 46.0  # metres; the right end is at 10

Pair = tuple[Tensor, Tensor]

# --- points -----------------------------------------------------------------------------


def project(homography: Tensor, x: Tensor, y: Tensor) -> Pair:
    """Points through a homography (3,3); float64, of the common shape of x and y.

    A point at infinity comes out infinite or NaN. Points behind the camera are projected
    like any other: the kit does not test for them, and its cells are all in front.
    """
    # Not a matrix product: its rounding differs between machines, and cells hang on it.
    across, down, scale = (a * x + b * y + c for a, b, c in homography.tolist())
    return across / scale, down / scale


def cell_to_road(row: Tensor, column: Tensor) -> Pair:
    """The centre (x, z) of cells, float64, rounded to float32 as the kit does."""
    x = LEFT + (column.double() + 0.5) * CELL
    z = FAR - (row.double() + 0.5) * CELL
    return x.float().double(), z.float().double()


def road_to_cell(x: Tensor, z: Tensor) -> Pair:
    """Row and column of the cells of points, whole numbers in float64, also beyond the map.

    Rounded half to even and one less, as the kit does: half a cell left of and farther
    than the cell that holds the point.
    """
    column = ((x - LEFT) / CELL).round() - 1
    row = (ROWS - (z - NEAR) / CELL).round() - 1
    return row, column


def image_to_pixel(u: Tensor, v: Tensor) -> Pair:
    """Row and column of the pixels of image points, whole numbers in float64.

    The nearest lower pixel, counted from one by the kit.
    """
    return v.floor() - 1, u.floor() - 1


def pixel_to_image(row: Tensor, column: Tensor) -> Pair:
    """The image point (u, v) of pixels, float64."""
    return column.double() + 1, row.double() + 1


# --- maps -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Lookup:
    """Where each place of a new map comes from; shared between calls, never changed.

    index: int64 (R,C), the source's flat index, 0 where there is none. inside: bool (R,C),
    False where there is no source. size: rows and columns of the source.
    """

    index: Tensor
    inside: Tensor
    size: tuple[int, int]

    def __call__(self, values: Tensor) -> Tensor:
        """Values (…,H,W) of any type as (…,R,C) of that type; 0 where there is no source.

        Raises ValueError for values of another size than the source.
        """
        if tuple(values.shape[-2:]) != self.size:
            raise ValueError(f"the map is {tuple(values.shape[-2:])}, not {self.size}")
        index, inside = self.index.to(values.device), self.inside.to(values.device)
        taken = values.flatten(-2).index_select(-1, index.flatten())
        return taken.unflatten(-1, index.shape).masked_fill(~inside, 0)


def _lookup(pixel: Pair, inside: Tensor, size: tuple[int, int]) -> Lookup:
    row, column = pixel
    flat = torch.where(inside, row * size[1] + column, 0)  # first: NaN has no integer
    return Lookup(flat.long(), inside, size)


@lru_cache(maxsize=4)  # 3 MB each; the maps of one picture come one after the other
def cell_pixels(calibration: Calibration, height: int, width: int) -> Lookup:
    """The picture's pixel of each cell (800,400): what is submitted and scored.

    A cell has a pixel where 1 ≤ u ≤ width and 1 ≤ v ≤ height. Sampling takes single
    pixels, so thresholds and rounding may come before or after it.
    """
    u, v = project(road_to_image(calibration), *cell_to_road(*_places(ROWS, COLUMNS)))
    inside = (u >= 1) & (u <= width) & (v >= 1) & (v <= height)
    return _lookup(image_to_pixel(u, v), inside, (height, width))


@lru_cache(maxsize=4)
def pixel_cells(calibration: Calibration, height: int, width: int) -> Lookup:
    """The cell of each pixel (height,width): a bird's-eye map seen from the camera.

    Not the inverse of ``cell_pixels``: cells there stand for their centres, here for
    their corners (see ``road_to_cell``).
    """
    u, v = pixel_to_image(*_places(height, width))
    row, column = road_to_cell(*project(image_to_road(calibration), u, v))
    inside = (row >= 0) & (row < ROWS) & (column >= 0) & (column < COLUMNS)
    return _lookup((row, column), inside, (ROWS, COLUMNS))


def _places(rows: int, columns: int) -> Pair:
    """Row (R,1) and column (1,C) of every place of a map."""
    return torch.arange(rows)[:, None], torch.arange(columns)[None]


def to_birds_eye(values: Tensor, calibration: Calibration) -> Tensor:
    """Values (…,H,W) of a picture as (…,800,400), type kept; 0 where no pixel shows the cell."""
    height, width = values.shape[-2:]
    return cell_pixels(calibration, height, width)(values)


def to_image(cells: Tensor, calibration: Calibration, height: int, width: int) -> Tensor:
    """Cells (…,800,400) as (…,height,width), type kept; 0 for pixels that show no cell."""
    return pixel_cells(calibration, height, width)(cells)
