"""coco.json: the masks of all images with saved polygons, as one COCO file."""

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path, PurePath

import numpy as np

from roadtorch.base.atomic import atomic_write
from roadtorch.base.bounded import from_printable
from roadtorch.data.polygons import coco_annotation, read_labelme_mask
from roadtorch.run.folder import COCO_FILE
from roadtorch.run.ledger import INDEX_FILE, IndexRow, has_result, read_index

LABELME_SUFFIX = ".labelme.json"  # suffix of the labelme annotation of an image


def write_coco(folder: Path) -> None:
    """Write all images with saved polygons, sorted by file, as one COCO file.

    It is rebuilt from the files of the folder, so that it is complete after interrupted runs.
    Raises InputError when it cannot be written, DatasetError for an unreadable annotation.
    """
    rows = read_index(folder / INDEX_FILE).values()
    saved = [row for row in rows if not row.failed and "polygons" in row.saved.split()]
    ready = [row for row in saved if has_result(folder, _annotation_name(folder, row.file))]
    ready.sort(key=lambda row: row.file)

    def mask_of(row: IndexRow) -> np.ndarray:
        """Fill the polygons of an image's annotation, bool (H, W)."""
        size = int(row.height), int(row.width)
        return read_labelme_mask(folder / _annotation_name(folder, row.file), size)

    with atomic_write(folder / COCO_FILE) as path, path.open("w", encoding="utf-8") as text:
        text.writelines(coco_text(ready, mask_of))


def _annotation_name(folder: Path, file: str) -> str:
    """Return the annotation's name for a file in index.csv: a frame has no suffix, an image one."""
    of_image = PurePath(file).with_suffix("").as_posix() + LABELME_SUFFIX
    names = file + LABELME_SUFFIX, of_image, from_printable(of_image)
    return next((name for name in names if has_result(folder, name)), of_image)


def coco_text(
    images: Sequence[IndexRow], mask_of: Callable[[IndexRow], np.ndarray]
) -> Iterator[str]:
    """Yield the text of a COCO file with one annotation of category 1, road, per image with road.

    mask_of: returns the mask of an image, bool (H, W); called once each, in order. Images and
    annotations are numbered from 1 in their order. ``score`` is the trust, as in COCO results.
    """
    yield '{"info": {"description": "roads found by roadtorch"}, "licenses": [],\n'
    yield '"categories": [{"id": 1, "name": "road", "supercategory": ""}],\n"images": ['
    for number, image in enumerate(images, 1):
        size = {"width": int(image.width), "height": int(image.height)}
        entry = {"id": number, "file_name": image.file, **size}
        yield ("\n" if number == 1 else ",\n") + json.dumps(entry)
    yield '],\n"annotations": ['
    separator = "\n"
    for number, image in enumerate(images, 1):
        mask = mask_of(image)
        if not mask.any():
            continue
        score = {"score": float(image.trust)} if image.trust else {}
        yield separator + json.dumps(coco_annotation(mask, number, number, 1) | score)
        separator = ",\n"
    yield "]}\n"
