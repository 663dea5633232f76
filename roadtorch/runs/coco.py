"""coco.json: the masks of a whole run as COCO polygons, made of what is kept of each picture."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath

import numpy as np

from roadtorch.data.annotations import read_annotation
from roadtorch.data.polygons import filled_shapes
from roadtorch.io.atomic import atomic
from roadtorch.runs.index import Row
from roadtorch.runs.results import SUFFIXES
from roadtorch.sinks.polygons import ROAD, CocoPicture, coco_text

COCO = "coco.json"


@dataclass(frozen=True)
class SavedMasks(Mapping[str, np.ndarray]):
    """The masks bool (H,W) that annotation files draw, by picture; each is read when asked for.

    rows: of the pictures. found: gives the annotation file of that name, on this machine.
    """

    rows: Mapping[str, Row]
    found: Callable[[str], Path]

    def __getitem__(self, file: str) -> np.ndarray:
        """The mask of a picture; DatasetError when its annotation cannot be read."""
        row = self.rows[file]
        annotation = read_annotation(self.found(annotation_name(file)))
        shapes = [(one.shape, int(one.name == ROAD)) for one in annotation.drawings]
        return filled_shapes(shapes, (int(row.height), int(row.width))) > 0

    def __iter__(self) -> Iterator[str]:
        """The files of the pictures."""
        return iter(self.rows)

    def __len__(self) -> int:
        """How many there are."""
        return len(self.rows)


def annotation_name(file: str) -> str:
    """The annotation file of a picture that index.csv calls ``file``, below the results."""
    return PurePath(file).with_suffix("").as_posix() + SUFFIXES["polygons"]


def write_coco(path: Path, rows: Iterable[Row], found: Callable[[str], Path]) -> None:
    """Write the pictures whose polygons are kept, sorted by file, as one COCO file.

    A second run makes it anew of all that is there, so that it is whole whatever was
    interrupted. found: gives the annotation file of that name. Raises InputError when ``path``
    cannot be written, DatasetError for an annotation that cannot be read.
    """
    ready = {row.file: row for row in rows if not row.failed and "polygons" in row.saved.split()}
    pictures = [
        CocoPicture(
            row.file,
            (int(row.width), int(row.height)),
            float(row.trust) if row.trust else None,
        )
        for row in sorted(ready.values(), key=lambda row: row.file)
    ]
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.writelines(coco_text(pictures, SavedMasks(ready, found)))
