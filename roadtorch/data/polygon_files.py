"""Corrections as the files of LabelMe (XML) and labelme (JSON), as ``annotations`` reads them.

Untouched pixels are an object called ``ignore``: they are void to whoever reads the files as truth,
and untouched again when they come back.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from roadtorch.data.annotations import Drawing, read_annotation
from roadtorch.data.correction_labels import LABELS
from roadtorch.data.corrections import Correction
from roadtorch.data.painted import painted_regions
from roadtorch.data.polygons import filled_shapes
from roadtorch.errors import DatasetError
from roadtorch.io.atomic import make_folder, write_text

UNTOUCHED = "ignore"

CORNERS = 3  # polygons of fewer are repeated points: readers want three


def write_xml(corrections: Sequence[Correction], folder: Path) -> None:
    """Write FOLDER/NAME.xml for each picture, as P3's tool has it."""
    for one in corrections:
        root = Element("annotation")
        SubElement(root, "filename").text = Path(one.name).name
        size = SubElement(root, "imagesize")
        SubElement(size, "nrows").text, SubElement(size, "ncols").text = map(str, one.labels.shape)
        for number, (name, outline) in enumerate(_objects(one.labels)):
            thing = SubElement(root, "object")
            SubElement(thing, "name").text = name
            SubElement(thing, "deleted").text = "0"
            SubElement(thing, "id").text = str(number)
            polygon = SubElement(thing, "polygon")
            for x, y in outline.tolist():
                point = SubElement(polygon, "pt")
                SubElement(point, "x").text, SubElement(point, "y").text = str(x), str(y)
        indent(root)
        _write(_beside(folder, one.name, ".xml"), tostring(root, encoding="unicode") + "\n")


def write_labelme(corrections: Sequence[Correction], folder: Path) -> None:
    """Write FOLDER/NAME.json for each picture, as the program labelme has it."""
    for one in corrections:
        shapes = [
            {
                "label": name,
                "points": outline.astype(float).tolist(),
                "group_id": None,
                "shape_type": "polygon",
                "flags": {},
            }
            for name, outline in _objects(one.labels)
        ]
        document = {
            "version": "5.5.0",
            "flags": {},
            "shapes": shapes,
            "imagePath": Path(one.name).name,
            "imageData": None,
            "imageHeight": one.labels.shape[0],
            "imageWidth": one.labels.shape[1],
        }
        _write(_beside(folder, one.name, ".json"), json.dumps(document) + "\n")


def _objects(labels: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """What is painted: the name and the outline int (N,2), N ≥ 3, of each region."""
    for region in painted_regions(labels):
        name = LABELS[region.label] if region.label else UNTOUCHED
        outline = region.outline
        while len(outline) < CORNERS:
            outline = np.concatenate([outline, outline[-1:]])
        yield name, outline


def _beside(folder: Path, name: str, ending: str) -> Path:
    return (folder / name).with_suffix(ending)


def _write(path: Path, text: str) -> None:
    make_folder(path.parent)
    write_text(path, text)


def read_drawn(path: Path, size: tuple[int, int]) -> np.ndarray:
    """The labels uint8 (H,W) in a file of either kind.

    Objects of other names than ours are not road, as everywhere. Raises DatasetError naming the
    file when it cannot be read, or is for another picture size.
    """
    annotation = read_annotation(path)
    if annotation.size not in (None, size):
        what = f"is for {annotation.size[1]} by {annotation.size[0]} pixels"
        raise DatasetError(path, what, f"its picture has {size[1]} by {size[0]}")
    return filled_shapes([(part.shape, _number(part)) for part in annotation.drawings], size)


def _number(part: Drawing) -> int:
    if part.name == UNTOUCHED:
        return 0
    return LABELS.index(part.name) if part.name in LABELS else LABELS.index("not_road")
