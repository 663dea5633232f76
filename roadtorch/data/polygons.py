"""Truth from drawn shapes: filling them with their outline, and agreeing over people.

Boundary pixels belong to a shape: corners are rounded to the nearest pixel, and a pixel is
filled when its centre is inside or on the polygon through them, or on a border drawn one
pixel wide. Rasterisers differ by up to one pixel along borders; labelme's own fills with
the outline too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import cv2
import numpy as np
import torch

from roadtorch.data.dataset import Truth

OTHER, ROAD, VOID = 0, 1, 2  # what a person says about a pixel

Agreement = Literal["majority", "union", "intersection"]


class Shape(Protocol):
    """Something drawn on a picture; x to the right, y down, pixel centres at whole numbers."""

    def bounds(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom."""
        ...

    def fill(self, canvas: np.ndarray, value: int) -> None:
        """Write ``value`` to the pixels of the shape in a canvas uint8 (H,W); clipped there."""
        ...


@dataclass(frozen=True, eq=False)
class Polygon:
    """A closed polygon; points float64 (N,2), N ≥ 1, as (x, y)."""

    points: np.ndarray

    def bounds(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom."""
        (left, top), (right, bottom) = self.points.min(0), self.points.max(0)
        return float(left), float(top), float(right), float(bottom)

    def fill(self, canvas: np.ndarray, value: int) -> None:
        """Fill the polygon and its border."""
        corners = np.floor(self.points + 0.5).astype(np.int32)
        low = np.minimum(corners.min(0), 0)
        # OpenCV moves borders that leave its canvas, hence one that holds every corner.
        width, height = np.maximum(corners.max(0) + 1, canvas.shape[::-1]) - low
        wide = np.zeros((height, width), np.uint8)
        cv2.fillPoly(wide, [corners - low], 1)
        rows, columns = canvas.shape
        canvas[wide[-low[1] :, -low[0] :][:rows, :columns] > 0] = value


@dataclass(frozen=True)
class Disc:
    """All pixels whose centre is at most ``radius`` from (x, y)."""

    x: float
    y: float
    radius: float

    def bounds(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom."""
        x, y, radius = self.x, self.y, self.radius
        return x - radius, y - radius, x + radius, y + radius

    def fill(self, canvas: np.ndarray, value: int) -> None:
        """Fill the disc."""
        rows, columns = np.ogrid[: canvas.shape[0], : canvas.shape[1]]
        canvas[(columns - self.x) ** 2 + (rows - self.y) ** 2 <= self.radius**2] = value


@dataclass(frozen=True, eq=False)
class Stamp:
    """A mask bool (h,w) whose upper left pixel lies on column ``left`` and row ``top``."""

    left: int
    top: int
    mask: np.ndarray

    def bounds(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom."""
        rows, columns = self.mask.shape
        return self.left, self.top, self.left + columns - 1, self.top + rows - 1

    def fill(self, canvas: np.ndarray, value: int) -> None:
        """Fill the pixels where the mask is true."""
        top, left = max(self.top, 0), max(self.left, 0)
        inside = self.mask[top - self.top :, left - self.left :]
        target = canvas[top : top + inside.shape[0], left : left + inside.shape[1]]
        target[inside[: target.shape[0], : target.shape[1]]] = value


def filled_shapes(shapes: Sequence[tuple[Shape, int]], size: tuple[int, int]) -> np.ndarray:
    """Paint one person's shapes one over the other: uint8 (H,W), ``OTHER`` where nothing is.

    Each shape comes with what it stands for, so that a later object of another class cuts
    a hole into an earlier one, and blobs of the same class are united.
    """
    canvas = np.full(size, OTHER, np.uint8)
    for shape, value in shapes:
        shape.fill(canvas, value)
    return canvas


def agree(said: Mapping[str, np.ndarray], size: tuple[int, int], agreement: Agreement) -> Truth:
    """The truth (H,W) that follows from what several people said, each uint8 (H,W).

    A pixel is road when more than half of the people say so (``majority``), any of them
    (``union``) or all (``intersection``). Who said void at a pixel is not counted there,
    and it is void where all of them did [ours: one person's blur is no verdict]. Without
    anybody nothing is road and nothing void.
    """
    if not said:
        nothing = torch.zeros(size, dtype=torch.bool)
        return Truth(nothing, ~nothing)
    votes, known = torch.zeros(size, dtype=torch.int32), torch.zeros(size, dtype=torch.int32)
    for values in map(torch.from_numpy, said.values()):
        votes += values == ROAD
        known += values != VOID
    valid = known > 0
    road = {"majority": 2 * votes > known, "union": votes > 0, "intersection": votes == known}
    return Truth(road[agreement] & valid, valid)
