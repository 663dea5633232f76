"""Polygons of masks: filling them, outlines for labelme, regions for COCO.

Border pixels belong to a polygon: corners are rounded to the nearest pixel, and a pixel is filled
when its centre is inside or on the polygon through them, or on a border drawn one pixel wide.
Coordinates are x to the right and y down, pixel centres at whole numbers.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from pydantic import Field

from roadtorch.base.documents import Coordinate, ForeignDocument, Side, read_document

MIN_CORNERS = 3  # of a polygon, even of one pixel

OUTLINE_LABELS = ("not road", "road")
"""Labels of outlines; a hole follows the road around it and overwrites it."""


def fill_polygon(points: np.ndarray, canvas: np.ndarray, value: int) -> None:
    """Fill a closed polygon and its border in a canvas uint8 (H, W).

    points: (N, 2), N ≥ 1, as (x, y); they may lie outside the canvas.
    """
    corners = np.floor(points + 0.5).astype(np.int32)
    low = np.minimum(corners.min(0), 0)
    # OpenCV moves borders that leave its canvas, hence one that holds every corner.
    width, height = np.maximum(corners.max(0) + 1, canvas.shape[::-1]) - low
    padded = np.zeros((height, width), np.uint8)
    cv2.fillPoly(padded, [corners - low], 1)
    rows, columns = canvas.shape
    canvas[padded[-low[1] :, -low[0] :][:rows, :columns] > 0] = value


# --- outlines ---------------------------------------------------------------------------


def trace_outlines(mask: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Return the outlines that, filled in order, reproduce a mask bool (H, W) exactly.

    Each is 1 (road) or 0 (a hole in it), and a closed polygon int (N, 2), N ≥ 3, through centres of
    border pixels, as (x, y). A polygon covers its region and the holes in it; later
    ones overwrite holes with 0, and islands in these with 1. Borders are followed as by
    Suzuki and Abe, "Topological structural analysis of digitized binary images" (1985). Polygons of
    one or two pixels repeat their last corner.
    """
    polygons: list[tuple[int, np.ndarray]] = []
    target, canvas = mask.astype(np.uint8), np.zeros(mask.shape, np.uint8)
    while (wrong := canvas != target).any():
        for label in (1, 0):
            region = (wrong & (target == label)).astype(np.uint8)
            borders = cv2.findContours(region, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
            for border in sorted(borders, key=lambda border: tuple(border.reshape(-1, 2)[0])):
                points = border.reshape(-1, 2)
                missing = max(MIN_CORNERS - len(points), 0)
                points = np.concatenate([points, np.repeat(points[-1:], missing, 0)])
                polygons.append((label, points))
                cv2.fillPoly(canvas, [border], label)
    return polygons


def labelme_document(mask: np.ndarray, file: str) -> dict[str, Any]:
    """Return the outlines of a mask bool (H, W) in labelme's format, for the image beside it."""
    height, width = mask.shape
    shapes = [
        {
            "label": OUTLINE_LABELS[label],
            "points": points.tolist(),
            "group_id": None,
            "description": "",
            "shape_type": "polygon",
            "flags": {},
            "mask": None,
        }
        for label, points in trace_outlines(mask)
    ]
    return {
        "version": "5.5.0",
        "flags": {},
        "shapes": shapes,
        "imagePath": file,
        "imageData": None,
        "imageHeight": height,
        "imageWidth": width,
    }


class _Shape(ForeignDocument):
    label: str
    points: Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(min_length=MIN_CORNERS)]


class _Document(ForeignDocument):
    shapes: tuple[_Shape, ...]
    imageHeight: Side  # noqa: N815, as labelme has it
    imageWidth: Side  # noqa: N815


def read_labelme_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Read the mask bool (H, W) of a ``labelme_document``; DatasetError for any other file."""
    mask = np.zeros(size, np.uint8)
    with read_document(path, "remove it and infer the image again") as data:
        document = _Document.model_validate_json(data)
        if (document.imageHeight, document.imageWidth) != size:
            labelled = f"{document.imageWidth} by {document.imageHeight}"
            raise ValueError(f"it is for {labelled} pixels, its image has {size[1]} by {size[0]}")
        for shape in document.shapes:
            points = np.array(shape.points).round().astype(np.int32)
            cv2.fillPoly(mask, [points], int(shape.label == OUTLINE_LABELS[1]))
    return mask > 0


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
