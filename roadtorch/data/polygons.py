"""Truth from drawn shapes: filling them with their outline, and agreeing over people.

Boundary pixels belong to a shape: corners are rounded to the nearest pixel, and a pixel is
filled when its centre is inside or on the polygon through them, or on a border drawn one
pixel wide. Rasterisers differ by up to one pixel along borders; labelme's own fills with
the outline too.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import cv2
import numpy as np
import torch

from roadtorch.data.dataset import Truth

OTHER, ROAD, VOID = 0, 1, 2  # what a person says about a pixel

Agreement = Literal["majority", "union", "intersection"]

Fill = Callable[[np.ndarray, int], None]
"""Writes a value to the pixels of a shape in a canvas uint8 (H,W); clipped there.

x is to the right, y down, pixel centres at whole numbers.
"""


def fill_polygon(points: np.ndarray, canvas: np.ndarray, value: int) -> None:
    """Fill a closed polygon and its border; points (N,2), N ≥ 1, as (x, y)."""
    corners = np.floor(points + 0.5).astype(np.int32)
    low = np.minimum(corners.min(0), 0)
    # OpenCV moves borders that leave its canvas, hence one that holds every corner.
    width, height = np.maximum(corners.max(0) + 1, canvas.shape[::-1]) - low
    wide = np.zeros((height, width), np.uint8)
    cv2.fillPoly(wide, [corners - low], 1)
    rows, columns = canvas.shape
    canvas[wide[-low[1] :, -low[0] :][:rows, :columns] > 0] = value


def fill_disc(x: float, y: float, radius: float, canvas: np.ndarray, value: int) -> None:
    """Fill all pixels whose centre is at most ``radius`` from (x, y)."""
    rows, columns = np.ogrid[: canvas.shape[0], : canvas.shape[1]]
    canvas[(columns - x) ** 2 + (rows - y) ** 2 <= radius**2] = value


def fill_stamp(left: int, top: int, mask: np.ndarray, canvas: np.ndarray, value: int) -> None:
    """Fill where a mask bool (h,w) is true, its upper left pixel on column left and row top."""
    row, column = max(top, 0), max(left, 0)
    inside = mask[row - top :, column - left :]
    target = canvas[row : row + inside.shape[0], column : column + inside.shape[1]]
    target[inside[: target.shape[0], : target.shape[1]]] = value


def filled_shapes(shapes: Sequence[tuple[Fill, int]], size: tuple[int, int]) -> np.ndarray:
    """Paint one person's shapes one over the other: uint8 (H,W), ``OTHER`` where nothing is.

    Each shape comes with what it stands for, so that a later object of another class cuts
    a hole into an earlier one, and blobs of the same class are united.
    """
    canvas = np.full(size, OTHER, np.uint8)
    for fill, value in shapes:
        fill(canvas, value)
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
