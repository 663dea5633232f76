"""Corrections out to other programs and in again, by the name of the format."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from roadtorch.data.correction_labels import LABELS
from roadtorch.data.corrections import Correction
from roadtorch.data.cvat import read_cvat_mask, read_labelmap, write_cvat
from roadtorch.data.label_studio import TASKS, read_label_studio, write_label_studio
from roadtorch.data.labels import read_labels
from roadtorch.data.polygon_files import read_drawn, write_labelme, write_xml
from roadtorch.errors import DatasetError
from roadtorch.io.atomic import make_folder
from roadtorch.io.image import write_labels

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
    for one in corrections:
        road = np.where(one.road > 1, 255, one.road)
        layers = {"labels": one.labels, "road": road, "layout": one.layout}
        for name, values in layers.items():
            path = _png(folder / name, one.name)
            make_folder(path.parent)
            write_labels(path, torch.from_numpy(values))


def read_png(folder: Path, sizes: Sizes) -> dict[str, np.ndarray]:
    """What ``write_png`` wrote to FOLDER/labels; DatasetError for other numbers and sizes."""
    found = {}
    for name, path in _present(folder / "labels", sizes, _png):
        labels = read_labels(path)
        if labels.max() >= len(LABELS):
            what = f"has the unknown value {labels.max()}"
            raise DatasetError(path, what, f"known: 0 to {len(LABELS) - 1}")
        found[name] = labels.astype(np.uint8)
    return _fitting(found, sizes, folder)


def _png(folder: Path, name: str) -> Path:
    return (folder / name).with_suffix(".png")


def _present(
    folder: Path, sizes: Sizes, place: Callable[[Path, str], Path]
) -> Iterator[tuple[str, Path]]:
    """The pictures whose file is there, with it; DatasetError where there is none at all."""
    found = [(name, path) for name in sizes if (path := place(folder, name)).is_file()]
    if not found:
        what = "has no file for any of the pictures"
        raise DatasetError(folder, what, "give the folder that holds the labels")
    yield from found


def _fitting(found: dict[str, np.ndarray], sizes: Sizes, folder: Path) -> dict[str, np.ndarray]:
    """The labels, if they have the sizes of their pictures; DatasetError naming the first not."""
    for name, labels in found.items():
        if labels.shape != sizes[name]:
            what = f"has labels of {labels.shape[1]} by {labels.shape[0]} pixels for {name}"
            raise DatasetError(folder, what, "labels must have the size of the picture")
    return found


# --- the others -------------------------------------------------------------------------


def read_xml(folder: Path, sizes: Sizes) -> dict[str, np.ndarray]:
    """FOLDER/NAME.xml of every picture that has one."""
    return _drawn(folder, sizes, ".xml")


def read_labelme(folder: Path, sizes: Sizes) -> dict[str, np.ndarray]:
    """FOLDER/NAME.json of every picture that has one."""
    return _drawn(folder, sizes, ".json")


def _drawn(folder: Path, sizes: Sizes, ending: str) -> dict[str, np.ndarray]:
    def place(root: Path, name: str) -> Path:
        return (root / name).with_suffix(ending)

    return {name: read_drawn(path, sizes[name]) for name, path in _present(folder, sizes, place)}


def read_cvat(folder: Path, sizes: Sizes) -> dict[str, np.ndarray]:
    """FOLDER/SegmentationClass of an export that was unzipped."""
    classes = read_labelmap(folder / "labelmap.txt")
    present = _present(folder / "SegmentationClass", sizes, _png)
    return _fitting({name: read_cvat_mask(path, classes) for name, path in present}, sizes, folder)


def read_tasks(folder: Path, sizes: Sizes) -> dict[str, np.ndarray]:
    """FOLDER/tasks.json, or a file of any name."""
    return read_label_studio(folder / TASKS if folder.is_dir() else folder, sizes)


FORMATS: Mapping[str, CorrectionFormat] = {
    "labelme": CorrectionFormat(write_labelme, read_labelme),
    "xml": CorrectionFormat(write_xml, read_xml),
    "png": CorrectionFormat(write_png, read_png),
    "cvat": CorrectionFormat(write_cvat, read_cvat),
    "label-studio": CorrectionFormat(write_label_studio, read_tasks),
}
