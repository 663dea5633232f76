"""Polygons of masks: filling those that were drawn, and regions for COCO."""

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np


def fill_polygon(points: np.ndarray, canvas: np.ndarray, value: int) -> None:
    """Fill a closed polygon and its border in a canvas uint8 (H, W).

    Corners are rounded to the nearest pixel; a pixel is filled when its centre is inside or on the
    polygon through them, or on a border drawn one pixel wide.

    points: (N, 2), N ≥ 1, as (x, y), pixel centres at whole numbers; they may lie outside.
    """
    corners = np.floor(points + 0.5).astype(np.int32)
    low = np.minimum(corners.min(0), 0)
    # OpenCV moves borders that leave its canvas, hence one that holds every corner.
    width, height = np.maximum(corners.max(0) + 1, canvas.shape[::-1]) - low
    padded = np.zeros((height, width), np.uint8)
    cv2.fillPoly(padded, [corners - low], 1)
    rows, columns = canvas.shape
    canvas[padded[-low[1] :, -low[0] :][:rows, :columns] > 0] = value


# --- COCO -------------------------------------------------------------------------------


def coco_annotation(mask: np.ndarray, number: int, image: int, category: int) -> dict[str, Any]:
    """Return the COCO annotation of a non-empty mask bool (H, W)."""
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
    """Consecutive rows of one run each, of which each touches one run above and one below."""

    top: int
    runs: list[tuple[int, int]] = field(default_factory=list)

    def polygon(self) -> list[int]:
        """Return x and y in turn, along the edges of the pixels: down the right, up the left."""
        rows = [(self.top + at + step, run) for at, run in enumerate(self.runs) for step in (0, 1)]
        points = [(end, row) for row, (_, end) in rows]
        points += [(start, row) for row, (start, _) in reversed(rows)]
        closed = np.array([points[-1], *points, points[0]])
        moves = np.abs(np.diff(closed, axis=0))
        is_corner = (moves[:-1] + moves[1:] > 0).all(1)  # neither straight down nor along a row
        return closed[1:-1][is_corner].reshape(-1).tolist()


def coco_polygons(mask: np.ndarray) -> list[list[int]]:
    """Return polygons without holes that share no pixel and whose union is a mask bool (H, W).

    COCO's readers unite polygons and cannot subtract holes, so regions are cut along rows where
    they part or meet (ours). Coordinates are of pixel edges: column x reaches from x to x + 1.
    """
    done: list[_Piece] = []
    open_pieces: list[_Piece] = []
    for row, line in enumerate(mask):
        steps = np.flatnonzero(np.diff(line.astype(np.int8), prepend=0, append=0)).tolist()
        runs = list(zip(steps[::2], steps[1::2], strict=True))  # where road begins and ends
        last = [piece.runs[-1] for piece in open_pieces]
        below = [[run for run in runs if run[0] < end and start < run[1]] for start, end in last]
        continued: dict[tuple[int, int], _Piece] = {}
        for piece, touching in zip(open_pieces, below, strict=True):
            if len(touching) == 1 and sum(touching[0] in runs_below for runs_below in below) == 1:
                continued[touching[0]] = piece
            else:
                done.append(piece)
        open_pieces = [continued.get(run) or _Piece(row) for run in runs]
        for piece, run in zip(open_pieces, runs, strict=True):
            piece.runs.append(run)
    return [piece.polygon() for piece in [*done, *open_pieces]]
