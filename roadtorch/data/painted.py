"""Labels as polygons that, painted one over the other, give the labels back pixel by pixel.

Programs that know polygons alone have no holes; but a later polygon covers an earlier one. Every
4-connected region is painted with all that it encloses, the largest first, so that what lies in a
hole, untouched pixels as well, is painted after it (ours).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from roadtorch.data.correction_labels import LABELS


@dataclass(frozen=True, eq=False)
class Region:
    """A 4-connected region of one label: its number, its outline int (N,2) as (x, y)."""

    label: int
    outline: np.ndarray
    area: float  # pixels, those it encloses as well


def painted_regions(labels: np.ndarray) -> list[Region]:
    """The regions of labels uint8 (H,W) in the order in which they are painted."""
    found = [
        region for number in range(len(LABELS)) for region in _regions_of(labels == number, number)
    ]
    return sorted(found, key=lambda one: -one.area)


def _regions_of(mask: np.ndarray, label: int) -> Iterator[Region]:
    count, parts, boxes, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    for part in range(1, count):
        left, top, width, height, _ = boxes[part].tolist()
        inside = (parts[top : top + height, left : left + width] == part).astype(np.uint8)
        outlines, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        outline = outlines[0][:, 0, :]
        canvas = np.zeros_like(inside)
        cv2.fillPoly(canvas, [outline], 1)
        yield Region(label, outline + np.array([left, top]), float(canvas.sum()))


def connected_parts(labels: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Each 4-connected region that is not untouched: its label and its mask bool (H,W)."""
    for number in range(1, len(LABELS)):
        count, parts = cv2.connectedComponents((labels == number).astype(np.uint8), connectivity=4)
        for part in range(1, count):
            yield number, parts == part
