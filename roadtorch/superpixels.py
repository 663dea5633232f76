"""SLIC superpixels in tensors, and the squares that P2 compares them with.

Every pixel is compared with the nine segment centres around its grid cell. Ordered
cell by cell, that is one small matrix product a cell; the centres are updated by a
second one. Colours stay RGB: Lab is in the metric between them. Achanta et al., "SLIC
Superpixels Compared to State-of-the-art Superpixel Methods", PAMI 2012, stands in for
the TurboPixels of P2 and P3: both give compact segments of about equal size that
follow edges.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from pydantic import Field
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor
from torch.nn import functional as F

from roadtorch.errors import ConfigError
from roadtorch.image_cache import cached_per_image
from roadtorch.settings import Settings

NEIGHBOURS = 9
"""A pixel can belong to the segment of its own grid cell or of the eight around it."""

LAB_TANGENT = (
    (0.2127, 0.7153, 0.0722),
    (0.9540, -1.4613, 0.5072),
    (0.3361, 1.0445, -1.3806),
)
"""Derivative of (L,a,b)/100 by gamma-encoded (R,G,B) at mid grey: Lab without its roots.
Street pictures are nearly grey, boundary recall stays within 0.01, and it is 6 times faster."""

SAMPLES = 5
"""Rows and columns of pixels by which a centre moves at least: every second or fourth of both,
where a segment has so many. A quarter of the work, or a sixteenth."""

CHUNK = 1 << 18
"""Distances held at a time: one megabyte."""

SMALLEST = 0.02
"""Regions below this share of the mean segment size are merged into a neighbour."""

FAR = 1e3
"""Every coordinate of a centre beyond the grid, or of no pixels: never the nearest."""

LONGEST = 4.0
"""No colour is as far from black, squared: see ``_tables``."""


class Superpixels(Settings):
    """Regions that follow the edges in the picture."""

    pixels: int = Field(default=256, ge=4, le=10**6, description="pixels of one superpixel, about")
    compactness: float = Field(
        default=0.07, gt=0, le=100, description="weight of distance against colour; high is square"
    )

    def cut(self, image: Tensor) -> Tensor:
        """Labels int64 (H,W) of an image (3,H,W); at least 16 segments where there is room."""
        return _cut(image, self)


@cached_per_image
def _cut(image: Tensor, superpixels: Superpixels) -> Tensor:
    pixels = image.shape[-2] * image.shape[-1]
    return slic(image, max(16, round(pixels / superpixels.pixels)), superpixels.compactness)


def squares(height: int, width: int, size: int) -> Tensor:
    """Cut a picture into squares of ``size`` pixels: int64 labels (H,W), 0…n-1 by rows.

    The squares at the right and the bottom edge are cut off there. P2, section 4 ("fixed
    square regions"). Raises ConfigError for a size below 1.
    """
    if size < 1:
        raise ConfigError("size", f"{size} was given", "give squares of 1 pixel or more")
    across = -(-width // size)
    rows = torch.arange(height) // size
    return rows[:, None] * across + torch.arange(width) // size


class CellGrid(NamedTuple):
    """The initial grid: rows and columns of cells, and a cell's height and width in pixels.

    stride: centres move by every so many-th pixel of every so many-th row; divides a cell's sides.
    """

    rows: int
    columns: int
    height: int
    width: int
    stride: int


def slic(
    image: Tensor, segments: int = 300, compactness: float = 0.07, iterations: int = 5
) -> Tensor:
    """Cut an image, or each image of a batch, into connected segments of similar colour.

    image: (3,H,W) or (B,3,H,W) in [0,1]. segments: how many to aim at (a few more or
    fewer come out). compactness: weight of the distance in the picture, in units of
    Lab/100 for one grid step; higher is more square. Returns int64 labels (H,W) or
    (B,H,W), 0…n-1 in each image, every segment 4-connected; the same input gives the
    same labels. Raises ConfigError when a setting is out of range.
    """
    if segments < 1 or compactness <= 0 or iterations < 1:
        given = f"segments={segments}, compactness={compactness}, iterations={iterations}"
        raise ConfigError("superpixels", given, "segments and iterations ≥ 1, compactness > 0")
    batch = image if image.ndim == 4 else image[None]
    height, width = batch.shape[-2:]
    grid = _grid(height, width, segments)
    metric = _metric(compactness * (segments / (height * width)) ** 0.5).to(batch)
    centres = _move_centres(batch, grid, metric, iterations)
    labels = connect(_assign(batch, centres, grid, metric), SMALLEST * height * width / segments)
    labels = labels.to(image.device)
    return labels if image.ndim == 4 else labels[0]


def _grid(height: int, width: int, segments: int) -> CellGrid:
    """About ``segments`` nearly square cells of even size that cover the picture."""
    side = (height * width / segments) ** 0.5
    stride = 4 if side >= 4 * SAMPLES else 2

    def cell(length: int) -> int:
        return stride * max(1, round(length / max(1, round(length / side)) / stride))

    tall, wide = cell(height), cell(width)
    return CellGrid(-(-height // tall), -(-width // wide), tall, wide, stride)


def _metric(step: float) -> Tensor:
    """M (5,5): |f-c|² = (f-c)ᵀM(f-c) of R, G, B, row, column; nearly Lab/100, and pixels·step."""
    lab = torch.tensor(LAB_TANGENT)
    return torch.block_diag(lab.T @ lab, step**2 * torch.eye(2))


def _cells(maps: Tensor, grid: CellGrid, stride: int) -> Tensor:
    """Every ``stride``-th pixel of maps (B,C,H,W): (B, rows, columns, C, pixels, pixels) of cells.

    0 beyond the picture.
    """
    maps = maps[..., ::stride, ::stride]
    tall, wide = grid.height // stride, grid.width // stride
    rows = -(-maps.shape[-2] // tall)
    beyond = grid.columns * wide - maps.shape[-1], rows * tall - maps.shape[-2]
    if any(beyond):
        maps = F.pad(maps, (0, beyond[0], 0, beyond[1]))
    blocks = maps.reshape(len(maps), -1, rows, tall, grid.columns, wide)
    return blocks.permute(0, 2, 4, 1, 3, 5)


@lru_cache(maxsize=16)
def _places(grid: CellGrid, stride: int) -> Tensor:
    """(3, pixels, pixels) of a cell: row and column from its middle, and 1."""
    row, column = (torch.arange(0, side, stride) - (side - 1) / 2 for side in grid[2:4])
    one = torch.ones(len(row), len(column))
    return torch.stack([row[:, None] * one, column * one, one])


@lru_cache(maxsize=16)
def _neighbours(grid: CellGrid) -> Tensor:
    """(cells, 9) int64: the cells around each, itself in the middle; ``cells`` beyond the grid."""
    cells = grid.rows * grid.columns
    framed = F.pad(torch.arange(cells).reshape(grid.rows, grid.columns), (1, 1, 1, 1), value=cells)
    return framed.unfold(0, 3, 1).unfold(1, 3, 1).reshape(cells, NEIGHBOURS)


@lru_cache(maxsize=16)
def _shifts(grid: CellGrid) -> Tensor:
    """(9,5): from the middle of a cell to those around it, in R, G, B, row, column."""
    number = torch.arange(NEIGHBOURS)
    row, column = grid.height * (number // 3 - 1), grid.width * (number % 3 - 1)
    return F.pad(torch.stack([row, column], 1), (3, 0)).to(torch.float32)


def _tables(sums: Tensor, grid: CellGrid, metric: Tensor) -> Tensor:
    """(B,cells,6) sums over segments → (B·cells, 9, 6) factors of the squared distances.

    |f-c|² - fᵀMf = -2 cᵀM f + cᵀMc: fᵀMf is the same for all nine. More than it can be is added,
    so that all are positive.
    """
    size = sums[..., 5:]
    centre = torch.where(size > 0, sums[..., :5] / size, FAR)
    around = F.pad(centre, (0, 0, 0, 1), value=FAR)
    around = around.index_select(1, _neighbours(grid).to(sums.device).reshape(-1))
    around = around.reshape(-1, NEIGHBOURS, 5) + _shifts(grid).to(sums)
    scaled = around @ metric
    most = LONGEST + float(metric[3, 3]) * (grid.height**2 + grid.width**2) / 4
    return torch.cat([-2 * scaled, (scaled * around).sum(-1, keepdim=True) + most], -1)


def _member_sums(tables: Tensor, points: Tensor) -> Tensor:
    """(cells, 9, 6): a cell's points summed by the centre nearest to them (where two are: both)."""
    distances = torch.bmm(tables, points)
    member = distances.eq_(distances.amin(1, keepdim=True))  # 0 and 1, without another copy
    return torch.bmm(member, points.transpose(1, 2))


def _move_centres(images: Tensor, grid: CellGrid, metric: Tensor, iterations: int) -> Tensor:
    """(B,cells,6): sums of the points over each segment after k-means on the grid.

    Rows and columns are those from the middle of the segment's own cell.
    """
    ones = images.new_ones(1, 1, *images.shape[-2:])
    places = _cells(ones, grid, grid.stride) * _places(grid, grid.stride).to(images)
    points = torch.cat(
        [_cells(images, grid, grid.stride), places.expand(len(images), *places.shape[1:])], 3
    )
    points = points.flatten(0, 2).flatten(2)
    cells, shifts = grid.rows * grid.columns, _shifts(grid).to(images)
    # To the cell above on the left this one is the one below on the right, and so on.
    opposite = NEIGHBOURS * _neighbours(grid) + torch.arange(NEIGHBOURS - 1, -1, -1)
    opposite = opposite.reshape(-1).to(images.device)
    sums = points.sum(2).reshape(-1, cells, 6)
    most = max(1, CHUNK // (NEIGHBOURS * points.shape[2]))
    for _ in range(iterations):
        chunks = zip(_tables(sums, grid, metric).split(most), points.split(most), strict=True)
        parts = torch.cat([_member_sums(*chunk) for chunk in chunks])
        parts[..., :5] -= parts[..., 5:] * shifts
        parts = F.pad(parts.reshape(-1, cells * NEIGHBOURS, 6), (0, 0, 0, NEIGHBOURS))
        sums = parts.index_select(1, opposite).reshape(-1, cells, NEIGHBOURS, 6).sum(2)
    return sums


def _assign(images: Tensor, centres: Tensor, grid: CellGrid, metric: Tensor) -> Tensor:
    """(B,H,W) int32 on the CPU: for each pixel the grid cell whose centre is nearest.

    Strip by strip: points and distances stay in the cache, and memory is linear in pixels.
    """
    batch, _, height, width = images.shape
    tables = _tables(centres, grid, metric).reshape(batch, grid.rows, grid.columns, NEIGHBOURS, 6)
    cells = np.arange(grid.rows * grid.columns, dtype=np.int32)
    cells = cells.reshape(grid.rows, 1, grid.columns, 1)
    move = np.add.outer([-grid.columns, 0, grid.columns], [-1, 0, 1]).astype(np.int32)
    shape = (batch, grid.rows, grid.height, grid.columns, grid.width)
    labels = np.empty(shape, dtype=np.int32)
    most = max(1, CHUNK // (NEIGHBOURS * labels[:, 0].size))
    strips = images.split(most * grid.height, 2)
    size = (batch, min(most, grid.rows), grid.columns, 6, grid.height, grid.width)
    points = images.new_empty(size)  # the last strip may fill less of it
    points[:, :, :, 3:] = _places(grid, 1).to(images)
    for top, strip in zip(range(0, grid.rows, most), strips, strict=True):
        rows = min(most, grid.rows - top)
        points[:, :rows, :, :3] = _cells(strip, grid, 1)
        factors = tables[:, top : top + rows].reshape(-1, NEIGHBOURS, 6)
        nearest = _nearest(factors, points[:, :rows].flatten(0, 2).flatten(2)).cpu().numpy()
        owner = move.take(nearest.reshape(batch, rows, *shape[3:4], grid.height, grid.width))
        np.add(
            owner.transpose(0, 1, 3, 2, 4), cells[top : top + rows], out=labels[:, top : top + rows]
        )
    whole = labels.reshape(batch, grid.rows * grid.height, grid.columns * grid.width)
    return torch.from_numpy(np.ascontiguousarray(whole[:, :height, :width]))


def _nearest(tables: Tensor, points: Tensor) -> Tensor:
    """(cells, pixels) int32, 0…8: which of the nine centres is nearest; the first if several are.

    Positive floats sort like their bits; the lowest four give way to the centre's number,
    which costs 2⁻¹⁹ of the distance and makes argmin a plain minimum (30 times faster).
    """
    distances = torch.bmm(tables, points).to(torch.float32)
    number = torch.arange(NEIGHBOURS, dtype=torch.int32, device=distances.device)
    keys = distances.view(torch.int32).bitwise_and_(~15).bitwise_or_(number[:, None])
    return keys.amin(1).bitwise_and_(15)


class Runs(NamedTuple):
    """Horizontal runs of equal label in pictures (B,H,W), in reading order.

    start: place of the first pixel of each among all pixels; length: pixels; region: the number
    of the 4-connected region that it is part of, from 0, as they are met.
    """

    start: np.ndarray
    length: np.ndarray
    region: np.ndarray


def connect(labels: Tensor, smallest: float = 1.0) -> Tensor:
    """Make every segment 4-connected and number the segments 0…n-1 in each picture.

    labels: integers (B,H,W). Of each label the largest region stays, unless it has fewer
    than ``smallest`` pixels; the pixels of every other region join a settled segment that
    they touch, from its border inwards. Returns int64 (B,H,W).
    """
    pictures = labels.cpu().numpy().astype(np.int32)
    stride = int(pictures.max()) + 1
    pictures += np.arange(len(pictures), dtype=np.int32)[:, None, None] * stride
    start, length, region = _runs(pictures)
    size = np.bincount(region, length).astype(np.int64)
    label = np.empty(len(size), dtype=np.int32)
    label[region] = pictures.reshape(-1)[start]
    picture = label // stride
    settled = _largest_of(label, size) & (size >= smallest) | _largest_of(picture, size)
    number = _numbers_within(picture, settled)[region]
    grown = _grow(number.repeat(length).reshape(pictures.shape))
    return torch.from_numpy(grown).to(labels.device)


def _runs(pictures: np.ndarray) -> Runs:
    """The runs of pictures (B,H,W) whose labels differ from picture to picture."""
    begins = np.ones(pictures.shape, dtype=bool)
    np.not_equal(pictures[..., 1:], pictures[..., :-1], out=begins[..., 1:])
    start = np.flatnonzero(begins)
    length = np.diff(start, append=begins.size)
    run = np.arange(len(start), dtype=np.int32).repeat(length)
    # Where either of two runs begins that lie above one another: once for each such pair. The
    # first row of a picture has no labels in common with the last one of the picture before.
    rows, begins = pictures.reshape(-1, pictures.shape[2]), begins.reshape(-1, pictures.shape[2])
    above = np.flatnonzero((rows[1:] == rows[:-1]) & (begins[1:] | begins[:-1]))
    one, two = run[above], run[above + pictures.shape[2]]
    first = np.zeros(len(start) + 1, dtype=np.int32)
    np.cumsum(np.bincount(one, minlength=len(start)), out=first[1:])
    touching = csr_array((np.ones(len(one), dtype=np.int8), two, first), shape=(len(start),) * 2)
    return Runs(start, length, connected_components(touching, directed=False)[1])


def _largest_of(group: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Whether a region is the largest of its group; the first one where sizes are equal."""
    rank = (size + 1) * len(size) - np.arange(len(size))
    best = np.zeros(group.max() + 1, dtype=rank.dtype)
    np.maximum.at(best, group, rank)
    return rank == best[group]


def _numbers_within(picture: np.ndarray, settled: np.ndarray) -> np.ndarray:
    """Settled regions numbered 0…n-1 in each picture, as they are met; -1 for the others."""
    kept = np.nonzero(settled)[0]
    kept = kept[np.argsort(picture[kept], kind="stable")]
    starts = np.searchsorted(picture[kept], picture[kept])
    number = np.full(len(picture), -1, dtype=np.int32)
    number[kept] = np.arange(len(kept)) - starts
    return number


def _grow(numbers: np.ndarray) -> np.ndarray:
    """Fill the pixels -1 of maps (B,H,W) from their 4 neighbours: int64.

    Round by round; each takes the highest number it touches, so that the result does not depend
    on an order.
    """
    batch, height, width = numbers.shape
    framed = np.full((batch, height + 2, width + 2), -2, dtype=np.int64)
    framed[:, 1:-1, 1:-1] = numbers
    flat, wide = framed.reshape(-1), width + 2
    empty = np.flatnonzero(flat == -1)
    while len(empty):
        highest = flat[empty - wide]
        for move in (-1, 1, wide):
            np.maximum(highest, flat[empty + move], out=highest)
        flat[empty] = highest
        empty = empty[highest < 0]
    return np.ascontiguousarray(framed[:, 1:-1, 1:-1])
