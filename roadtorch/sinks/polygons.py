"""Labels as polygons: outlines as labelme draws them, and COCO's."""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import cv2
import numpy as np

ROAD, HOLE = "road", "not road"
"""Labels of outlines. A hole is drawn behind what it is in, and cuts it; readers need no more."""

CORNERS = 3  # a polygon needs as many, even that of one pixel


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
    found: list[Outline] = []
    wanted, drawn = labels.astype(np.uint8), np.full(labels.shape, ground, np.uint8)
    while (missing := drawn != wanted).any():
        for label in reversed(np.unique(wanted[missing]).tolist()):
            region = (missing & (wanted == label)).astype(np.uint8)
            borders = cv2.findContours(region, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
            for border in sorted(borders, key=lambda one: tuple(one.reshape(-1, 2)[0])):
                points = border.reshape(-1, 2)
                lacking = max(CORNERS - len(points), 0)
                points = np.concatenate([points, np.repeat(points[-1:], lacking, 0)])
                found.append(Outline(label, points))
                cv2.fillPoly(drawn, [border], label)
    return found


def labelme_document(
    labels: np.ndarray, picture: str, names: Sequence[str] = (HOLE, ROAD), ground: int = 0
) -> dict[str, Any]:
    """The outlines of labels (H,W) as the program labelme stores them; of a mask bool as well.

    picture: the file name of the picture, which belongs beside the annotation. names: of the
    labels. ground: as in ``outlines``.
    """
    height, width = labels.shape
    shapes = [
        {
            "label": names[outline.label],
            "points": outline.points.tolist(),
            "group_id": None,
            "description": "",
            "shape_type": "polygon",
            "flags": {},
            "mask": None,
        }
        for outline in outlines(labels, ground)
    ]
    return {
        "version": "5.5.0",
        "flags": {},
        "shapes": shapes,
        "imagePath": picture,
        "imageData": None,
        "imageHeight": height,
        "imageWidth": width,
    }


# --- COCO -------------------------------------------------------------------------------


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
        last = [one.runs[-1] for one in open_pieces]
        under = [[run for run in runs if run[0] < end and start < run[1]] for start, end in last]
        goes_on: dict[tuple[int, int], _Piece] = {}
        for one, touched in zip(open_pieces, under, strict=True):
            alone = len(touched) == 1 and sum(touched[0] in others for others in under) == 1
            if alone:
                goes_on[touched[0]] = one
            else:
                done.append(one)
        open_pieces = [goes_on.get(run) or _Piece(row) for run in runs]
        for one, run in zip(open_pieces, runs, strict=True):
            one.runs.append(run)
    return [one.polygon() for one in [*done, *open_pieces]]


class CocoPicture(NamedTuple):
    """A picture in a COCO file: its name, (width, height) and trust, where there is one."""

    file: str
    size: tuple[int, int]
    trust: float | None = None


def coco_text(
    pictures: Iterable[CocoPicture], mask_of: Callable[[str], np.ndarray]
) -> Iterator[str]:
    """A COCO file, in pieces: one annotation of category 1, road, for each picture with road.

    mask_of: gives the mask bool (H,W) of a file; each is asked for once, in order. Pictures and
    their annotations are numbered from 1 in the order given. ``score`` is the trust, as in COCO's
    results.
    """
    pictures = list(pictures)
    yield '{"info": {"description": "roads found by roadtorch"}, "licenses": [],\n'
    yield '"categories": [{"id": 1, "name": "road", "supercategory": ""}],\n"images": ['
    for number, one in enumerate(pictures, 1):
        width, height = one.size
        image = {"id": number, "file_name": one.file, "width": width, "height": height}
        yield ("\n" if number == 1 else ",\n") + json.dumps(image)
    yield '],\n"annotations": ['
    separator = "\n"
    for number, one in enumerate(pictures, 1):
        mask = mask_of(one.file)
        if not mask.any():
            continue
        rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
        left, top = int(columns[0]), int(rows[0])
        annotation = {
            "id": number,
            "image_id": number,
            "category_id": 1,
            "segmentation": coco_polygons(mask),
            "area": int(mask.sum()),
            "bbox": [left, top, int(columns[-1]) + 1 - left, int(rows[-1]) + 1 - top],
            "iscrowd": 0,
        }
        annotation |= {} if one.trust is None else {"score": one.trust}
        yield separator + json.dumps(annotation)
        separator = ",\n"
    yield "]}\n"
