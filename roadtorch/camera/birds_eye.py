"""KITTI's bird's-eye view: maps of a picture on the road plane, 800×400 cells of 5 cm.

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

from roadtorch.camera.calibration import Calibration, road_to_image

ROWS, COLUMNS = 800, 400

CELL = 0.05  # metres

LEFT, FAR = -10.0, 46.0  # metres; the right end is at 10, the near one at 6

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


def image_to_pixel(u: Tensor, v: Tensor) -> Pair:
    """Row and column of the pixels of image points, whole numbers in float64.

    The nearest lower pixel, counted from one by the kit.
    """
    return v.floor() - 1, u.floor() - 1


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


@lru_cache(maxsize=4)  # 3 MB each; the maps of one picture come one after the other
def cell_pixels(calibration: Calibration, height: int, width: int) -> Lookup:
    """The picture's pixel of each cell (800,400): what is submitted and scored.

    A cell has a pixel where 1 ≤ u ≤ width and 1 ≤ v ≤ height. Sampling takes single
    pixels, so thresholds and rounding may come before or after it.
    """
    cells = torch.arange(ROWS)[:, None], torch.arange(COLUMNS)[None]
    u, v = project(road_to_image(calibration), *cell_to_road(*cells))
    inside = (u >= 1) & (u <= width) & (v >= 1) & (v <= height)
    row, column = image_to_pixel(u, v)
    flat = torch.where(inside, row * width + column, 0)  # first: NaN has no integer
    return Lookup(flat.long(), inside, (height, width))


def to_birds_eye(values: Tensor, calibration: Calibration) -> Tensor:
    """Values (…,H,W) of a picture as (…,800,400), type kept; 0 where no pixel shows the cell."""
    height, width = values.shape[-2:]
    return cell_pixels(calibration, height, width)(values)
