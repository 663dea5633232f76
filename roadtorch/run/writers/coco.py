"""coco.json: the masks of all pictures whose outlines are kept, as one COCO file."""

import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np

from roadtorch.base.atomic import atomic
from roadtorch.data.polygons import coco_region, read_outlined_mask
from roadtorch.run.folder import COCO
from roadtorch.run.ledger import INDEX, has_result, read_index

POLYGONS = ".labelme.json"
"""How the name of the annotation file of a picture ends."""


def write_coco(folder: Path) -> None:
    """Write the pictures whose polygons are kept, sorted by file, as one COCO file.

    A second run makes it anew of all that is there, so that it is whole whatever was
    interrupted. Raises InputError when it cannot be written, DatasetError for an annotation
    that cannot be read.
    """
    rows = read_index(folder / INDEX).values()
    saved = [row for row in rows if not row.failed and "polygons" in row.saved.split()]
    ready = {
        row.file: row
        for row in sorted(saved, key=lambda row: row.file)
        if has_result(folder, _annotation(folder, row.file))
    }
    pictures = [
        CocoPicture(
            row.file,
            (int(row.width), int(row.height)),
            float(row.trust) if row.trust else None,
        )
        for row in ready.values()
    ]

    def mask_of(file: str) -> np.ndarray:
        """bool (H,W), as the annotation of a picture draws it."""
        size = int(ready[file].height), int(ready[file].width)
        return read_outlined_mask(folder / _annotation(folder, file), size)

    with atomic(folder / COCO) as temporary, temporary.open("w", encoding="utf-8") as text:
        text.writelines(coco_text(pictures, mask_of))


def _annotation(folder: Path, file: str) -> str:
    """The outline of what index.csv calls ``file``: a frame, without suffix, or a picture."""
    of_picture = PurePath(file).with_suffix("").as_posix() + POLYGONS
    return file + POLYGONS if has_result(folder, file + POLYGONS) else of_picture


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
    for number, picture in enumerate(pictures, 1):
        width, height = picture.size
        image = {"id": number, "file_name": picture.file, "width": width, "height": height}
        yield ("\n" if number == 1 else ",\n") + json.dumps(image)
    yield '],\n"annotations": ['
    separator = "\n"
    for number, picture in enumerate(pictures, 1):
        mask = mask_of(picture.file)
        if not mask.any():
            continue
        score = {} if picture.trust is None else {"score": picture.trust}
        yield separator + json.dumps(coco_region(mask, number, number, 1) | score)
        separator = ",\n"
    yield "]}\n"
