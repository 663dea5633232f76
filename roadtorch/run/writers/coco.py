"""NAME.coco.json and coco.json: the masks of one image and of all as COCO files."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path, PurePath

from roadtorch.base.atomic import atomic_write
from roadtorch.base.bounded import from_printable
from roadtorch.base.documents import ForeignDocument, read_document
from roadtorch.run.ledger import COCO_FILE, FRAME_NUMBER, IndexRow, has_result

POLYGONS_SUFFIX = ".coco.json"  # suffix of the COCO file of an image

Annotation = Mapping[str, object]


class _PolygonsFile(ForeignDocument):
    annotations: tuple[dict[str, object], ...]


def write_coco(folder: Path, rows: Iterable[IndexRow]) -> None:
    """Write all images of an index with saved polygons, sorted by file, as one COCO file.

    It is rebuilt from the files of the folder, so that it is complete after interrupted runs.
    Raises InputError when it cannot be written, DatasetError for an unreadable file of an image.
    """
    saved = (row for row in rows if not row.failed and "polygons" in row.saved.split())
    files = {row: name for row in saved if (name := _find_polygons(folder, row))}
    ready = sorted(files, key=lambda row: row.file)

    def read_regions(row: IndexRow) -> Sequence[Annotation]:
        """Read the annotations of an image."""
        path = folder / files[row]
        with read_document(path, "remove it and infer the image again") as data:
            return _PolygonsFile.model_validate_json(data).annotations

    with atomic_write(folder / COCO_FILE) as path, path.open("w", encoding="utf-8") as text:
        text.writelines(coco_text(ready, read_regions))


def _find_polygons(folder: Path, row: IndexRow) -> str | None:
    """Return the name of the polygons of an image or a frame; a source has none of its own."""
    stem = row.file if row.seconds else PurePath(row.file).with_suffix("").as_posix()
    is_source = row.seconds and not re.fullmatch(rf".*/{FRAME_NUMBER}", row.file)
    names = () if is_source else (stem + POLYGONS_SUFFIX, from_printable(stem + POLYGONS_SUFFIX))
    return next((name for name in names if has_result(folder, name)), None)


def coco_text(
    images: Sequence[IndexRow], read_regions: Callable[[IndexRow], Iterable[Annotation]]
) -> Iterator[str]:
    """Yield the text of a COCO file of the category 1, road.

    read_regions: returns the annotations of an image; called once each, in order. Images and
    annotations are numbered from 1 in their order. ``score`` is the trust, as in COCO results.
    """
    yield '{"info": {"description": "roads found by roadtorch"}, "licenses": [],\n'
    yield '"categories": [{"id": 1, "name": "road", "supercategory": ""}],\n"images": ['
    for number, image in enumerate(images, 1):
        size = {"width": int(image.width), "height": int(image.height)}
        entry = {"id": number, "file_name": image.file, **size}
        yield ("\n" if number == 1 else ",\n") + json.dumps(entry)
    yield '],\n"annotations": ['
    regions = ((*pair, region) for pair in enumerate(images, 1) for region in read_regions(pair[1]))
    for number, (image_id, image, region) in enumerate(regions, 1):
        score = {"score": float(image.trust)} if image.trust else {}
        entry = {**region, "id": number, "image_id": image_id, **score}
        yield ("\n" if number == 1 else ",\n") + json.dumps(entry)
    yield "]}\n"
