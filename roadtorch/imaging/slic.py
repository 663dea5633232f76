"""SLIC superpixels in tensors, and P2's squares.

K-means of colour and position, each pixel compared with the nine centres around its grid cell: for
each cell one small matrix product, and a second to update the centres. Colours stay RGB: Lab is in
the metric. Achanta et al., "SLIC Superpixels Compared to State-of-the-art Superpixel Methods", PAMI
2012, in place of the TurboPixels of P2 and P3, which also give compact segments along edges.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.image_cache import cached_per_image
from roadtorch.base.settings import Settings
from roadtorch.imaging.connectivity import connect

NEIGHBOURS = 9
"""Candidates of a pixel: the segments of its grid cell and of the eight around it."""

LAB_TANGENT = (
    (0.2127, 0.7153, 0.0722),
    (0.9540, -1.4613, 0.5072),
    (0.3361, 1.0445, -1.3806),
)
"""Jacobian of (L, a, b)/100 with respect to gamma-encoded (R, G, B) at mid grey: linearised Lab.
Street images are nearly grey: boundary recall stays within 0.01, at 6 times the speed."""

SAMPLES = 5
"""Least rows and columns of a cell that remain if its centre is updated from every fourth."""

CHUNK = 1 << 18
"""Distances computed at a time: one megabyte."""

MIN_SEGMENT = 0.02
"""Fraction of the mean segment size below which a region is merged into a neighbour."""

NOWHERE = 1e3
"""Coordinates of a centre without pixels or beyond the grid, so that it is never the nearest."""

MAX_LAB_SQUARE = 4.0
"""Bound on the squared distance of a colour from black: see ``_distance_maps``."""

COMPACTNESS = 0.07
"""Distance in Lab/100 that counts as much as one grid step; high values give squares."""

ITERATIONS = 5
"""Iterations of k-means."""


class Superpixels(Settings):
    """Superpixels: compact regions that follow the edges of an image."""

    pixels: int = Field(
        default=256,
        ge=16,
        le=10**6,
        description="average area of a superpixel in pixels of the working size, about",
    )

    def cut(self, image: Tensor) -> Tensor:
        """Return labels int64 (H, W) of an image (3, H, W); at least 16 segments where they fit."""
        return _cut(image, self)


@cached_per_image
def _cut(image: Tensor, superpixels: Superpixels) -> Tensor:
    pixels = image.shape[-2] * image.shape[-1]
    return slic(image, max(16, round(pixels / superpixels.pixels)))


def square_grid(height: int, width: int, size: int) -> Tensor:
    """Return labels of squares with sides of ``size``, int64 (H, W), 0…n-1 by rows (P2, section 4).

    Squares at the right and the lower edge are truncated.
    """
    across = -(-width // size)
    rows = torch.arange(height) // size
    return rows[:, None] * across + torch.arange(width) // size


class CellGrid(NamedTuple):
    """The initial grid: rows and columns of cells, height and width of a cell in pixels.

    stride: centres are updated from every stride-th pixel of every stride-th row; it divides the
    sides of a cell.
    """

    rows: int
    columns: int
    height: int
    width: int
    stride: int


def slic(image: Tensor, segments: int = 300) -> Tensor:
    """Cut an image (3, H, W) in [0, 1] into about ``segments`` superpixels: labels int64 (H, W).

    Labels are 0…n-1, and every segment is 4-connected.
    """
    height, width = image.shape[-2:]
    grid = _grid(height, width, segments)
    step = COMPACTNESS * (segments / (height * width)) ** 0.5
    distance_maps = _distance_maps(grid, step).to_image(image)
    coefficients = _coefficients(_move_centres(image, grid, distance_maps), distance_maps)
    labels = connect(_assign(image, coefficients, grid), MIN_SEGMENT * height * width / segments)
    return labels.to(image.device)


def _grid(height: int, width: int, segments: int) -> CellGrid:
    """Choose about ``segments`` nearly square cells of equal size that cover the image."""
    side = (height * width / segments) ** 0.5
    stride = 4 if side >= 4 * SAMPLES else 2

    def cell(length: int) -> int:
        return stride * max(1, round(length / max(1, round(length / side)) / stride))

    tall, wide = cell(height), cell(width)
    return CellGrid(-(-height // tall), -(-width // wide), tall, wide, stride)


def _cells(maps: Tensor, grid: CellGrid, stride: int) -> Tensor:
    """Split maps (C, H, W) into cells: (rows, columns, C, h, w), every ``stride``-th pixel.

    Pixels beyond the image are 0.
    """
    maps = maps[..., ::stride, ::stride]
    tall, wide = grid.height // stride, grid.width // stride
    rows = -(-maps.shape[-2] // tall)
    beyond = grid.columns * wide - maps.shape[-1], rows * tall - maps.shape[-2]
    if any(beyond):
        maps = F.pad(maps, (0, beyond[0], 0, beyond[1]))
    return maps.reshape(-1, rows, tall, grid.columns, wide).permute(1, 3, 0, 2, 4)


@lru_cache(maxsize=16)
@torch.inference_mode(False)  # kept for callers in any mode
def _positions(grid: CellGrid, stride: int) -> Tensor:
    """Return pixel positions of a cell (3, h, w): row and column from its middle, and 1."""
    row, column = (torch.arange(0, side, stride) - (side - 1) / 2 for side in grid[2:4])
    ones = torch.ones(len(row), len(column))
    return torch.stack([row[:, None] * ones, column * ones, ones])


class DistanceMaps(NamedTuple):
    """Linear maps between sums over segments, sums over cells and coefficients of distances.

    metric: (5, 5). factors: (7, 54), from a centre c, cᵀMc and 1 to its 9 × 6 coefficients, seen
    from the cells of which it is the 1st, 2nd, … neighbour. sums: (54, 6), from a segment's sums in
    the nine cells around it to their total, seen from the segment's own cell. neighbours: int64
    (cells·9,), index of the coefficients that a cell needs. back: int64 ((cells+1)·9,), index of
    the sums that a segment needs; the last segment is beyond the grid.
    """

    metric: Tensor
    factors: Tensor
    sums: Tensor
    neighbours: Tensor
    back: Tensor

    def to_image(self, image: Tensor) -> "DistanceMaps":
        """Move to the device of an image, floating-point parts to its precision."""
        dtypes = (image.dtype if part.is_floating_point() else part.dtype for part in self)
        parts = zip(self, dtypes, strict=True)
        return DistanceMaps(*(part.to(image.device, dtype) for part, dtype in parts))


@lru_cache(maxsize=16)
@torch.inference_mode(False)  # kept for callers in any mode
def _distance_maps(grid: CellGrid, step: float) -> DistanceMaps:
    """Build the maps for squared distances |f-c-s|², where s is the offset of c's cell.

    |f-c|² = (f-c)ᵀM(f-c) over R, G, B, row, column: nearly Lab/100, and pixels times ``step``. In
    |f-c|² - fᵀMf = -2 cᵀMf + cᵀMc the term fᵀMf is common to all nine neighbours. An upper bound of
    it is added, so that all values are positive.
    """
    lab, number = torch.tensor(LAB_TANGENT), torch.arange(NEIGHBOURS)
    metric = torch.block_diag(lab.T @ lab, step**2 * torch.eye(2))
    # Offsets from a cell to its neighbours, in R, G, B, row, column.
    offsets = torch.stack([grid.height * (number // 3 - 1), grid.width * (number % 3 - 1)], 1)
    shifts = F.pad(offsets, (3, 0)).to(torch.float32)
    projected = shifts @ metric
    most = MAX_LAB_SQUARE + float(metric[3, 3]) * (grid.height**2 + grid.width**2) / 4
    factors = metric.new_zeros(NEIGHBOURS, 7, 6)
    factors[:, :5, :5] = -2 * metric
    factors[:, :5, 5] = 2 * projected
    factors[:, 5, 5] = 1
    factors[:, 6, :5] = -2 * projected
    factors[:, 6, 5] = (projected * shifts).sum(1) + most
    sums = torch.eye(6).repeat(NEIGHBOURS, 1, 1)
    sums[:, 5, :5] = shifts
    cells = torch.arange(grid.rows * grid.columns)
    framed = F.pad(cells.reshape(grid.rows, grid.columns), (1, 1, 1, 1), value=len(cells))
    # The 3×3 cells around each cell; len(cells) stands for beyond the grid.
    neighbours = framed.unfold(0, 3, 1).unfold(1, 3, 1).reshape(-1, NEIGHBOURS)
    beyond = torch.full((1, NEIGHBOURS), len(neighbours))
    return DistanceMaps(
        metric,
        factors.permute(1, 0, 2).reshape(7, -1),
        sums.reshape(-1, 6),
        (NEIGHBOURS * neighbours + number).reshape(-1),
        # To its upper left neighbour a cell is the lower right one, and so on.
        (NEIGHBOURS * torch.cat([neighbours, beyond]) + number.flip(0)).reshape(-1),
    )


def _coefficients(sums: Tensor, maps: DistanceMaps) -> Tensor:
    """Turn sums over segments (cells+1, 6) into distance coefficients (cells, 9, 6).

    The last segment is the one beyond the grid, of no pixels.
    """
    centre = (sums[:, :5] / sums[:, 5:]).nan_to_num_(NOWHERE)  # 0/0: no pixels
    square = (centre @ maps.metric).mul_(centre).sum(1)
    terms = torch.addmm(maps.factors[6], centre, maps.factors[:5]).addr_(square, maps.factors[5])
    return terms.reshape(-1, 6).index_select(0, maps.neighbours).reshape(-1, NEIGHBOURS, 6)


def _move_centres(image: Tensor, grid: CellGrid, maps: DistanceMaps) -> Tensor:
    """Run k-means on the grid; return sums of the points over each segment, (cells+1, 6).

    Rows and columns are relative to the middle of the segment's own cell; the last sums are 0.
    """
    ones = image.new_ones(1, *image.shape[-2:])
    positions = _cells(ones, grid, grid.stride) * _positions(grid, grid.stride).to(image)
    points = torch.cat([_cells(image, grid, grid.stride), positions], 2).flatten(0, 1).flatten(2)
    turned = points.transpose(1, 2).contiguous()
    parts = points.new_zeros(len(points) + 1, NEIGHBOURS, 6)  # the last is beyond the grid
    most = max(1, CHUNK // (NEIGHBOURS * points.shape[2]))
    chunks = [slice(at, at + most) for at in range(0, len(points), most)]
    sums = F.pad(points.sum(2), (0, 0, 0, 1))
    for _ in range(ITERATIONS):
        coefficients = _coefficients(sums, maps)
        for chunk in chunks:
            distances = torch.bmm(coefficients[chunk], points[chunk])
            # One-hot of the nearest of the nine (of both where they tie), in place.
            member = distances.eq_(distances.amin(1, keepdim=True))
            torch.bmm(member, turned[chunk], out=parts[:-1][chunk])
        sums = parts.reshape(-1, 6).index_select(0, maps.back)
        sums = sums.reshape(-1, NEIGHBOURS * 6) @ maps.sums
    return sums


def _assign(image: Tensor, coefficients: Tensor, grid: CellGrid) -> Tensor:
    """Assign each pixel to the grid cell with the nearest centre: (H, W) int32 on the CPU.

    Works in strips, so that points and distances fit the cache and memory is linear in pixels.
    """
    _, height, width = image.shape
    coefficients = coefficients.reshape(grid.rows, grid.columns, NEIGHBOURS, 6)
    cells = np.arange(grid.rows * grid.columns, dtype=np.int32)
    cells = cells.reshape(grid.rows, 1, grid.columns, 1)
    move = np.add.outer([-grid.columns, 0, grid.columns], [-1, 0, 1]).astype(np.int32)
    labels = np.empty((grid.rows, grid.height, grid.columns, grid.width), dtype=np.int32)
    most = max(1, CHUNK // (NEIGHBOURS * labels[0].size))
    strips = image.split(most * grid.height, 1)
    size = (min(most, grid.rows), grid.columns, 6, grid.height, grid.width)
    points = image.new_empty(size)  # the last strip may be shorter
    points[:, :, 3:] = _positions(grid, 1).to(image)
    for top, strip in zip(range(0, grid.rows, most), strips, strict=True):
        rows = slice(top, min(top + most, grid.rows))
        count = rows.stop - top
        points[:count, :, :3] = _cells(strip, grid, 1)
        factors = coefficients[rows].reshape(-1, NEIGHBOURS, 6)
        nearest = _nearest(factors, points[:count].flatten(0, 1).flatten(2)).cpu().numpy()
        owner = move.take(nearest.reshape(count, grid.columns, grid.height, grid.width))
        np.add(owner.transpose(0, 2, 1, 3), cells[rows], out=labels[rows])
    whole = labels.reshape(grid.rows * grid.height, grid.columns * grid.width)
    return torch.from_numpy(np.ascontiguousarray(whole[:height, :width]))


def _nearest(coefficients: Tensor, points: Tensor) -> Tensor:
    """Find the nearest of nine centres: (cells, pixels) int32, 0…8, the first of equals.

    Positive floats sort like their bits; the lowest four give way to the centre's number, which
    costs 2⁻¹⁹ of the distance and makes argmin a plain minimum (30 times faster).
    """
    distances = torch.bmm(coefficients, points).to(torch.float32)
    number = torch.arange(NEIGHBOURS, dtype=torch.int32, device=distances.device)
    keys = distances.view(torch.int32).bitwise_and_(~15).bitwise_or_(number[:, None])
    return keys.amin(1).bitwise_and_(15)
