"""coco.json: the masks of all images whose outlines are kept, as one COCO file."""

import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np

from roadtorch.base.atomic import atomic
from roadtorch.data.polygons import coco_region, read_outlined_mask
from roadtorch.run.folder import COCO_FILE
from roadtorch.run.ledger import INDEX, has_result, read_index

POLYGONS = ".labelme.json"
"""How the name of the annotation file of an image ends."""


def write_coco(folder: Path) -> None:
    """Write the images whose polygons are kept, sorted by file, as one COCO file.

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
    images = [
        CocoImage(
            row.file,
            (int(row.width), int(row.height)),
            float(row.trust) if row.trust else None,
        )
        for row in ready.values()
    ]

    def mask_of(file: str) -> np.ndarray:
        """bool (H,W), as the annotation of an image draws it."""
        size = int(ready[file].height), int(ready[file].width)
        return read_outlined_mask(folder / _annotation(folder, file), size)

    with atomic(folder / COCO_FILE) as temporary, temporary.open("w", encoding="utf-8") as text:
        text.writelines(coco_text(images, mask_of))


def _annotation(folder: Path, file: str) -> str:
    """The outline of what index.csv calls ``file``: a frame, without suffix, or an image."""
    of_image = PurePath(file).with_suffix("").as_posix() + POLYGONS
    return file + POLYGONS if has_result(folder, file + POLYGONS) else of_image


class CocoImage(NamedTuple):
    """An image in a COCO file: its name, (width, height) and trust, where there is one."""

    file: str
    size: tuple[int, int]
    trust: float | None = None


def coco_text(images: Iterable[CocoImage], mask_of: Callable[[str], np.ndarray]) -> Iterator[str]:
    """A COCO file, in pieces: one annotation of category 1, road, for each image with road.

    mask_of: gives the mask bool (H,W) of a file; each is asked for once, in order. Images and
    their annotations are numbered from 1 in the order given. ``score`` is the trust, as in COCO's
    results.
    """
    images = list(images)
    yield '{"info": {"description": "roads found by roadtorch"}, "licenses": [],\n'
    yield '"categories": [{"id": 1, "name": "road", "supercategory": ""}],\n"images": ['
    for number, image in enumerate(images, 1):
        width, height = image.size
        entry = {"id": number, "file_name": image.file, "width": width, "height": height}
        yield ("\n" if number == 1 else ",\n") + json.dumps(entry)
    yield '],\n"annotations": ['
    separator = "\n"
    for number, image in enumerate(images, 1):
        mask = mask_of(image.file)
        if not mask.any():
            continue
        score = {} if image.trust is None else {"score": image.trust}
        yield separator + json.dumps(coco_region(mask, number, number, 1) | score)
        separator = ",\n"
    yield "]}\n"
