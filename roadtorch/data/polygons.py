"""Regions of masks as polygons and as run lengths: filled, encoded, for COCO."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np


def fill_polygon(points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the mask bool (H, W) of a closed polygon and its border.

    Corners are rounded to the nearest pixel; a pixel is filled when its centre is inside or on the
    polygon through them, or on a border drawn one pixel wide.

    points: (N, 2), N ≥ 1, as (x, y), pixel centres at whole numbers; they may lie outside.
    """
    corners = np.floor(points + 0.5).astype(np.int32)
    low = np.minimum(corners.min(0), 0)
    # OpenCV moves borders that leave its canvas, hence one that holds every corner.
    width, height = np.maximum(corners.max(0) + 1, size[::-1]) - low
    canvas = np.zeros((height, width), np.uint8)
    cv2.fillPoly(canvas, [corners - low], 1)
    rows, columns = size
    return canvas[-low[1] :, -low[0] :][:rows, :columns] > 0


def fill_area(points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the mask bool (H, W) of the pixels whose centre is inside a polygon: even-odd rule.

    points: (N, 2) as (x, y), in pixel edges; they may lie outside.
    """
    limits = size[::-1]
    left, top = points.min(0).clip(0, limits).astype(int).tolist()
    right, bottom = np.ceil(points.max(0)).clip(0, limits).astype(int).tolist()
    crossings = np.zeros((bottom - top, right - left + 1), np.bool_)
    corners = (points - [left + 0.5, top + 0.5]).tolist()  # to pixel centres
    for (x1, y1), (x2, y2) in zip(corners, [*corners[1:], corners[0]], strict=True):
        first, last = sorted((math.ceil(y1), math.ceil(y2)))
        rows = np.arange(max(first, 0), min(last, bottom - top))
        if len(rows):
            columns = x1 + (rows - y1) * ((x2 - x1) / (y2 - y1))
            crossings[rows, np.ceil(columns).clip(0, right - left).astype(int)] ^= True
    mask = np.zeros(size, np.bool_)
    mask[top:bottom, left:right] = np.logical_xor.accumulate(crossings, axis=1)[:, :-1]
    return mask


# --- run lengths ------------------------------------------------------------------------


def encode_counts(mask: np.ndarray) -> tuple[int, ...]:
    """Return COCO's counts of a mask bool (H, W): pixels outside and inside in turn, by column."""
    edges = np.flatnonzero(np.diff(mask.T.reshape(-1), prepend=False))
    return tuple(np.diff(edges, prepend=0, append=mask.size).tolist())


def decode_counts(counts: Sequence[int], size: tuple[int, int]) -> np.ndarray:
    """Return the mask bool (H, W) of COCO's counts; ValueError for those of another size."""
    height, width = size
    if sum(counts) != height * width:
        raise ValueError(f"{sum(counts)} pixels are counted, not {width} by {height}")
    return np.repeat(np.arange(len(counts)) % 2 == 1, counts).reshape(width, height).T


def unpack_counts(text: str) -> list[int]:
    """Unpack compressed counts, as pycocotools' ``rleFrString`` does; ValueError for other text.

    Five bits a letter, the lowest first; bit 5: more follow; bit 4 of the last: it is negative.
    From the fourth count on it is the difference to the count before the last.
    """
    counts: list[int] = []
    value, shift = 0, 0
    for letter in text:
        code = ord(letter) - 48
        if not 0 <= code < 64 or shift > 30:
            raise ValueError(f"compressed counts have {letter!r}, which pycocotools does not write")
        value |= (code & 31) << shift
        shift += 5
        if code & 32:
            continue
        value -= (code & 16) << (shift - 4)
        counts.append(value + (counts[-2] if len(counts) > 2 else 0))
        if counts[-1] < 0:
            raise ValueError("compressed counts have a negative one")
        value, shift = 0, 0
    if shift:
        raise ValueError("compressed counts are cut short")
    return counts


# --- COCO -------------------------------------------------------------------------------


def coco_annotation(mask: np.ndarray, number: int, image: int, category: int) -> dict[str, object]:
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
