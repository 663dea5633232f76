"""Corrections out to other programs and in again, by the name of the format.

In LabelMe's XML and labelme's JSON untouched pixels are an object called ``ignore``: they are void
to whoever reads the files as truth, and untouched again when they come back.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import torch

from roadtorch.data.annotations import read_annotation
from roadtorch.data.correction_labels import LABELS, check_stems
from roadtorch.data.corrections import Correction
from roadtorch.data.cvat import read_cvat_mask, read_labelmap, write_cvat
from roadtorch.data.label_studio import read_label_studio, write_label_studio
from roadtorch.data.labels import read_labels
from roadtorch.data.polygons import filled_shapes
from roadtorch.errors import DatasetError
from roadtorch.io.atomic import make_folder, write_text
from roadtorch.io.image import write_labels
from roadtorch.sinks.polygons import labelme_document, outlines

DRAWN = ("ignore", *LABELS[1:])
"""What labels are called in files of polygons, by their number."""

NOTHING = 255  # no label: every pixel is drawn, untouched ones as well

Sizes = Mapping[str, tuple[int, int]]
"""(height, width) of pictures by their relative name with ending."""


@dataclass(frozen=True)
class CorrectionFormat:
    """How another program keeps labels.

    write: corrections to a folder. read: labels uint8 (H,W) by picture, from a folder and for the
    pictures in ``Sizes``; those that the folder does not speak of are left out.
    """

    write: Callable[[Sequence[Correction], Path], None]
    read: Callable[[Path, Sizes], dict[str, np.ndarray]]


# --- PNG --------------------------------------------------------------------------------


def write_png(corrections: Sequence[Correction], folder: Path) -> None:
    """FOLDER/labels, numbers of ``LABELS``; FOLDER/road and FOLDER/layout as sets have them.

    In road 0 is not road, 1 road, 255 void or untouched; in layout 255 is unknown.
    """
    check_stems(one.name for one in corrections)
    for one in corrections:
        road = np.where(one.road > 1, 255, one.road)
        layers = {"labels": one.labels, "road": road, "layout": one.layout}
        for name, values in layers.items():
            path = (folder / name / one.name).with_suffix(".png")
            make_folder(path.parent)
            write_labels(path, torch.from_numpy(values))


def read_png(folder: Path, sizes: Sizes) -> dict[str, np.ndarray]:
    """What ``write_png`` wrote to FOLDER/labels; DatasetError for other numbers and sizes."""
    found = {}
    for name, path in _present(folder / "labels", sizes, ".png"):
        labels = read_labels(path, sizes[name])
        if not np.isin(labels, range(len(LABELS))).all():
            what = f"has other values than 0 to {len(LABELS) - 1}"
            raise DatasetError(path, what, f"0 is {LABELS[0]}, 1 {LABELS[1]}, …")
        found[name] = labels.astype(np.uint8)
    return found


def _present(folder: Path, sizes: Sizes, ending: str) -> list[tuple[str, Path]]:
    """The pictures whose file is there, with it; DatasetError where there is none at all."""
    paths = {name: (folder / name).with_suffix(ending) for name in sizes}
    if not any(path.is_file() for path in paths.values()):
        what = "has no file for any of the pictures"
        raise DatasetError(folder, what, "give the folder that holds the labels")
    present = {name: path for name, path in paths.items() if path.is_file()}
    check_stems(present)
    return list(present.items())


# --- LabelMe (XML) and labelme (JSON) ---------------------------------------------------


def write_xml(corrections: Sequence[Correction], folder: Path) -> None:
    """Write FOLDER/NAME.xml for each picture, as P3's tool has it."""
    check_stems(one.name for one in corrections)
    for one in corrections:
        root = Element("annotation")
        SubElement(root, "filename").text = Path(one.name).name
        size = SubElement(root, "imagesize")
        SubElement(size, "nrows").text, SubElement(size, "ncols").text = map(str, one.labels.shape)
        for number, outline in enumerate(outlines(one.labels, NOTHING)):
            thing = SubElement(root, "object")
            SubElement(thing, "name").text = DRAWN[outline.label]
            SubElement(thing, "deleted").text = "0"
            SubElement(thing, "id").text = str(number)
            polygon = SubElement(thing, "polygon")
            for x, y in outline.points.tolist():
                point = SubElement(polygon, "pt")
                SubElement(point, "x").text, SubElement(point, "y").text = str(x), str(y)
        indent(root)
        _write(folder, one.name, ".xml", tostring(root, encoding="unicode"))


def write_labelme(corrections: Sequence[Correction], folder: Path) -> None:
    """Write FOLDER/NAME.json for each picture, as the program labelme has it."""
    check_stems(one.name for one in corrections)
    for one in corrections:
        document = labelme_document(one.labels, Path(one.name).name, DRAWN, NOTHING)
        _write(folder, one.name, ".json", json.dumps(document))


def _write(folder: Path, name: str, ending: str, text: str) -> None:
    path = (folder / name).with_suffix(ending)
    make_folder(path.parent)
    write_text(path, text + "\n")


def read_drawn(ending: str, folder: Path, sizes: Sizes) -> dict[str, np.ndarray]:
    """FOLDER/NAME.xml or .json of every picture that has one.

    Objects of other names than ours are not road, as everywhere. Raises DatasetError naming the
    file when it cannot be read, or is for another picture size.
    """
    found = {}
    for name, path in _present(folder, sizes, ending):
        shapes = [
            (part.fill, DRAWN.index(part.name) if part.name in DRAWN else LABELS.index("not_road"))
            for part in read_annotation(path, sizes[name])
        ]
        found[name] = filled_shapes(shapes, sizes[name])
    return found


# --- the others -------------------------------------------------------------------------


def read_cvat(folder: Path, sizes: Sizes) -> dict[str, np.ndarray]:
    """FOLDER/SegmentationClass of an export that was unzipped."""
    classes = read_labelmap(folder / "labelmap.txt")
    present = _present(folder / "SegmentationClass", sizes, ".png")
    return {name: read_cvat_mask(path, classes, sizes[name]) for name, path in present}


FORMATS: Mapping[str, CorrectionFormat] = {
    "labelme": CorrectionFormat(write_labelme, partial(read_drawn, ".json")),
    "xml": CorrectionFormat(write_xml, partial(read_drawn, ".xml")),
    "png": CorrectionFormat(write_png, read_png),
    "cvat": CorrectionFormat(write_cvat, read_cvat),
    "label-studio": CorrectionFormat(write_label_studio, read_label_studio),
}
