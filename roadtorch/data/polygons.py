"""Drawn shapes: filling them, agreeing over people; outlines of labels, and regions as in COCO.

Boundary pixels belong to a shape: corners are rounded to the nearest pixel, and a pixel is
filled when its centre is inside or on the polygon through them, or on a border drawn one
pixel wide. Rasterisers differ by up to one pixel along borders; labelme's own fills with
the outline too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
import torch

from roadtorch.data.dataset import Truth

OTHER, ROAD, VOID = 0, 1, 2  # what a person says about a pixel

CORNERS = 3  # a polygon needs as many, even that of one pixel

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


def agree(people: Sequence[np.ndarray], size: tuple[int, int], agreement: Agreement) -> Truth:
    """The truth (H,W) that follows from what several people said, each uint8 (H,W).

    A pixel is road when more than half of the people say so (``majority``), any of them
    (``union``) or all (``intersection``). Who said void at a pixel is not counted there,
    and it is void where all of them did [ours: one person's blur is no verdict]. Without
    anybody nothing is road and nothing void.
    """
    values = torch.from_numpy(np.stack(people or [np.full(size, OTHER, np.uint8)]))
    votes, known = (values == ROAD).sum(0), (values != VOID).sum(0)
    valid = known > 0
    road = {"majority": 2 * votes > known, "union": votes > 0, "intersection": votes == known}
    return Truth(road[agreement] & valid, valid)


# --- outlines ---------------------------------------------------------------------------


class Outline(NamedTuple):
    """A closed polygon int (N,2), N ≥ 3, through centres of border pixels, as (x, y); its label."""

    label: int
    points: np.ndarray


def outlines(labels: np.ndarray, ground: int = 0) -> list[Outline]:
    """The outlines of labels uint8 (H,W) that, filled one over the other, give them back exactly.

    ground: what a pixel is that nothing is drawn over. Regions first, then what lies in their
    holes, and so on: each drawing covers what it should and perhaps more, and the next one takes
    back the surplus. Suzuki and Abe, "Topological structural analysis of digitized binary images"
    (1985), follow the borders. Polygons of one or two pixels repeat their last corner.
    """
    drawing: list[Outline] = []
    wanted, drawn = labels.astype(np.uint8), np.full(labels.shape, ground, np.uint8)
    while (missing := drawn != wanted).any():
        for label in reversed(np.unique(wanted[missing]).tolist()):
            region = (missing & (wanted == label)).astype(np.uint8)
            borders = cv2.findContours(region, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
            for border in sorted(borders, key=lambda border: tuple(border.reshape(-1, 2)[0])):
                points = border.reshape(-1, 2)
                lacking = max(CORNERS - len(points), 0)
                points = np.concatenate([points, np.repeat(points[-1:], lacking, 0)])
                drawing.append(Outline(label, points))
                cv2.fillPoly(drawn, [border], label)
    return drawing


# --- COCO -------------------------------------------------------------------------------


def coco_region(mask: np.ndarray, number: int, image: int, category: int) -> dict[str, Any]:
    """The annotation of a number for a mask bool (H,W), of which a pixel at least is true."""
    rows, columns = (np.flatnonzero(mask.any(axis)).tolist() for axis in (1, 0))
    left, top = columns[0], rows[0]
    return {
        "id": number,
        "image_id": image,
        "category_id": category,
        "segmentation": coco_polygons(mask),
        "area": int(mask.sum()),
        "bbox": [left, top, columns[-1] + 1 - left, rows[-1] + 1 - top],
        "iscrowd": 0,
    }


@dataclass
class _Piece:
    """Runs of road one below the other: each touches one run above and one below."""

    top: int
    runs: list[tuple[int, int]] = field(default_factory=list)

    def polygon(self) -> list[int]:
        """x and y in turn, along the edges of its pixels: down the right side, up the left."""
        rows = [(self.top + at + step, run) for at, run in enumerate(self.runs) for step in (0, 1)]
        points = [(end, row) for row, (_, end) in rows]
        points += [(start, row) for row, (start, _) in reversed(rows)]
        around = np.array([points[-1], *points, points[0]])
        moves = np.abs(np.diff(around, axis=0))
        is_bend = (moves[:-1] + moves[1:] > 0).all(1)  # neither straight down nor along a row
        return around[1:-1][is_bend].reshape(-1).tolist()


def coco_polygons(mask: np.ndarray) -> list[list[int]]:
    """A mask bool (H,W) as polygons without holes that share no pixel; their union is exact.

    COCO's polygons are united by its readers and cannot have holes. So regions are cut along
    rows where they part or meet (ours). Coordinates are of pixel edges: column x reaches from
    x to x + 1.
    """
    done: list[_Piece] = []
    open_pieces: list[_Piece] = []
    for row, line in enumerate(mask):
        steps = np.flatnonzero(np.diff(line.astype(np.int8), prepend=0, append=0)).tolist()
        runs = list(zip(steps[::2], steps[1::2], strict=True))  # where road begins and ends
        last = [piece.runs[-1] for piece in open_pieces]
        under = [[run for run in runs if run[0] < end and start < run[1]] for start, end in last]
        goes_on: dict[tuple[int, int], _Piece] = {}
        for piece, touched in zip(open_pieces, under, strict=True):
            alone = len(touched) == 1 and sum(touched[0] in others for others in under) == 1
            if alone:
                goes_on[touched[0]] = piece
            else:
                done.append(piece)
        open_pieces = [goes_on.get(run) or _Piece(row) for run in runs]
        for piece, run in zip(open_pieces, runs, strict=True):
            piece.runs.append(run)
    return [piece.polygon() for piece in [*done, *open_pieces]]
