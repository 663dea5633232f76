"""Labelled sets of street pictures: camvid, idd-lite, folder.

A set is a list of items (paths) and a coding (what the numbers in its label files mean);
pictures and labels are read one at a time, so memory is flat over any number of items.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from roadtorch.errors import DatasetError, unknown_name
from roadtorch.image import SUFFIXES, read_image

SKY, VERTICAL, HORIZONTAL, NONE = 0, 1, 2, 255


@dataclass(frozen=True)
class Truth:
    """What is known about one picture.

    road: bool (H,W). valid: bool (H,W), False where nothing is known (void).
    layout: uint8 (H,W), 0 sky, 1 vertical, 2 horizontal, 255 void; None if the set has none.
    """

    road: Tensor
    valid: Tensor
    layout: Tensor | None


@dataclass(frozen=True)
class Coding:
    """What the values of a label file mean.

    road, void: the values of these two; layout: every value that may occur, with its
    layout class (255 for void), or no class at all in ``values`` (sets without layout).
    """

    road: tuple[int, ...]
    void: tuple[int, ...]
    values: tuple[int, ...]
    layout: tuple[int, ...] = ()  # as long as ``values``, or empty
    exclusive: tuple[int, ...] = ()  # values of which a file may use one only


@dataclass(frozen=True)
class Item:
    """One picture with its label file; ``group`` is the drive it is from, if known."""

    name: str
    image: Path
    label: Path
    group: str | None = None


@dataclass(frozen=True)
class Dataset:
    """A labelled set that has been found complete: every picture has its label file."""

    name: str
    root: Path
    split: str
    items: tuple[Item, ...]
    coding: Coding = field(repr=False)

    def groups(self) -> list[str]:
        """The drives, sorted; empty for a set that does not know them."""
        return sorted({item.group for item in self.items if item.group is not None})

    def truth(self, item: Item) -> Truth:
        """Read the label file of one item."""
        return decode_labels(read_labels(item.label), self.coding, item.label)

    def read(self, item: Item) -> tuple[Tensor, Truth]:
        """Read image (3,H,W) and truth; DatasetError when their sizes differ."""
        image, truth = read_image(item.image), self.truth(item)
        if image.shape[1:] != truth.road.shape:
            (height, width), (rows, columns) = image.shape[1:], truth.road.shape
            what = f"is {columns} by {rows} pixels, its picture {width} by {height}"
            raise DatasetError(item.label, what, "labels must have the size of the picture")
        return image, truth


# --- label files ------------------------------------------------------------------------


def read_labels(path: Path) -> np.ndarray:
    """The numbers (H,W) in a label file; palette files keep their indices.

    Raises DatasetError for a file that cannot be decoded or has different colour channels.
    """
    try:
        with Image.open(path) as picture:
            labels = np.asarray(picture)
    except (OSError, SyntaxError, ValueError) as problem:
        raise DatasetError(path, f"cannot be decoded: {problem}", "replace the file") from None
    if labels.ndim == 3:
        if (labels != labels[..., :1]).any():
            raise DatasetError(path, "is a colour picture", "give one number a pixel")
        labels = labels[..., 0]
    return labels.astype(np.uint8) if labels.dtype == np.bool_ else labels


def decode_labels(labels: np.ndarray, coding: Coding, path: Path) -> Truth:
    """Turn label numbers (H,W) into truth; DatasetError naming and counting unknown ones."""
    _check_values(labels, coding, path)
    road, valid, layout = _tables(coding)
    index = torch.from_numpy(labels.astype(np.int64))
    return Truth(road[index], valid[index], layout[index] if coding.layout else None)


def _check_values(labels: np.ndarray, coding: Coding, path: Path) -> None:
    values, counts = np.unique(labels, return_counts=True)
    strange = [
        f"{value} ({count} pixels)"
        for value, count in zip(values, counts, strict=True)
        if value not in coding.values
    ]
    known = ", ".join(map(str, coding.values))
    if strange:
        named = ", ".join(strange[:5]) + (" and others" if len(strange) > 5 else "")
        raise DatasetError(path, f"has unknown values {named}", f"known: {known}")
    mixed = [value for value in coding.exclusive if value in values]
    if len(mixed) > 1:
        what = f"has both {mixed[0]} and {mixed[1]}, each of which means road"
        raise DatasetError(path, what, "use one of them; void is 127 or 128")


@lru_cache
def _tables(coding: Coding) -> tuple[Tensor, Tensor, Tensor]:
    """Look-up tables over the values 0…255: is road, is valid, layout class."""
    road = torch.zeros(256, dtype=torch.bool)
    valid = torch.ones(256, dtype=torch.bool)
    layout = torch.full((256,), NONE, dtype=torch.uint8)
    road[list(coding.road)] = True
    valid[list(coding.void)] = False
    if coding.layout:
        layout[list(coding.values)] = torch.tensor(coding.layout, dtype=torch.uint8)
    return road, valid, layout


# --- finding the files ------------------------------------------------------------------


def pairs(images: Path, labels: Path) -> Iterator[tuple[Path, Path]]:
    """Every picture of a folder with its label file, a PNG of the same name.

    Raises DatasetError naming the first thing that is missing.
    """
    for folder in (images, labels):
        if not folder.is_dir():
            raise DatasetError(folder, "does not exist", "check the folder's layout")
    found = sorted(path for path in images.iterdir() if path.suffix.lower() in SUFFIXES)
    if not found:
        raise DatasetError(images, "holds no pictures", f"known endings: {' '.join(SUFFIXES)}")
    missing = [path for path in found if not (labels / f"{path.stem}.png").is_file()]
    if missing:
        first = labels / f"{missing[0].stem}.png"
        what = f"is missing, {len(missing)} of {len(found)} label files in all"
        raise DatasetError(first, what, "every picture needs its label file")
    for path in found:
        yield path, labels / f"{path.stem}.png"


CAMVID_CODING = Coding(
    road=(3,),
    void=(11,),
    values=tuple(range(12)),
    # sky, building, pole, road, pavement, tree, sign, fence, car, pedestrian, bicyclist, void
    layout=(SKY, *(VERTICAL,) * 2, *(HORIZONTAL,) * 2, *(VERTICAL,) * 6, NONE),
)
CAMVID_SPLITS = {"dev": ("train", "val"), "train": ("train",), "val": ("val",)}
DRIVE_LETTERS = 6  # CamVid names begin with the drive: 0001TP, 0006R0, 0016E5, Seq05V


def open_camvid(root: Path, split: str) -> Dataset:
    """CamVid in the 11-class layout: ROOT/train, ROOT/trainannot, ROOT/val, ROOT/valannot."""
    items = tuple(
        Item(image.stem, image, label, group=image.stem[:DRIVE_LETTERS])
        for part in CAMVID_SPLITS[split]
        for image, label in pairs(root / part, root / f"{part}annot")
    )
    return Dataset("camvid", root, split, items, CAMVID_CODING)


IDD_CODING = Coding(
    road=(0,),
    void=(255,),
    values=(*range(7), 255),
    # drivable, non-drivable, living things, vehicles, roadside objects, far objects, sky
    layout=(HORIZONTAL, HORIZONTAL, *(VERTICAL,) * 4, SKY, NONE),
)


def open_idd_lite(root: Path, split: str) -> Dataset:
    """IDD Lite, seven classes: ROOT/images, ROOT/labels. Road is "drivable"."""
    items = tuple(
        Item(image.stem, image, label) for image, label in pairs(root / "images", root / "labels")
    )
    return Dataset("idd-lite", root, split, items, IDD_CODING)


FOLDER_CODING = Coding(
    road=(1, 255), void=(127, 128), values=(0, 1, 127, 128, 255), exclusive=(1, 255)
)


def open_folder(root: Path, split: str) -> Dataset:
    """ROOT/images and ROOT/masks: 0 not road, 255 or 1 road, 127 or 128 void."""
    items = tuple(
        Item(image.stem, image, label) for image, label in pairs(root / "images", root / "masks")
    )
    return Dataset("folder", root, split, items, FOLDER_CODING)


@dataclass(frozen=True)
class Kind:
    """A layout of files that can be opened: its splits (the default first) and its opener."""

    splits: tuple[str, ...]
    open: Callable[[Path, str], Dataset]


DATASETS: Mapping[str, Kind] = {
    "camvid": Kind(tuple(CAMVID_SPLITS), open_camvid),
    "folder": Kind(("all",), open_folder),
    "idd-lite": Kind(("all",), open_idd_lite),
}


def open_dataset(name: str, root: Path, split: str | None = None) -> Dataset:
    """Open a labelled set; without ``split`` its default one.

    Raises ConfigError for an unknown name or split, DatasetError for an incomplete set.
    """
    if name not in DATASETS:
        raise unknown_name("data set", name, DATASETS)
    kind = DATASETS[name]
    if split is not None and split not in kind.splits:
        raise unknown_name(f"split of {name}", split, kind.splits)
    if not root.is_dir():
        raise DatasetError(root, "is not a folder", f"give the folder that holds {name}")
    return kind.open(root, split or kind.splits[0])
