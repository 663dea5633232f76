"""The sets that come with roadtorch: where their files lie and what their labels mean.

CamVid, KITTI and drawn annotations have modules of their own.
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from roadtorch.errors import DatasetError
from roadtorch.evaluation.datasets import HORIZONTAL, NONE, SKY, VERTICAL, Dataset, Item, Kind
from roadtorch.evaluation.labels import NumberLabels, is_picture, pairs
from roadtorch.evaluation.sets import camvid, kitti
from roadtorch.evaluation.sets.labelme import open_labelme

# --- folder -----------------------------------------------------------------------------

FOLDER_LABELS = NumberLabels(
    road=(1, 255), void=(127, 128), values=(0, 1, 127, 128, 255), exclusive=(1, 255)
)


def open_folder(root: Path, split: str) -> Dataset:
    """ROOT/images and ROOT/masks: 0 not road, 255 or 1 road, 127 or 128 void."""
    items = tuple(
        Item(image.stem, image, label) for image, label in pairs(root / "images", root / "masks")
    )
    return Dataset("folder", root, split, items, FOLDER_LABELS)


# --- IDD Lite ---------------------------------------------------------------------------

IDD_LABELS = NumberLabels(
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
    return Dataset("idd-lite", root, split, items, IDD_LABELS)


# --- Cityscapes -------------------------------------------------------------------------

# Cordts et al., CVPR 2016; numbers, names and what is left out as in its own scripts.
# -1, the licence plate, would be 255 in a byte.
CITYSCAPES_VOID = (*range(7), 9, 10, 14, 15, 16, 18, 29, 30, 255)
# Road, sidewalk and terrain: "all kinds of horizontal vegetation, soil or sand" by its
# definition. Parking and rail track would be horizontal too, but are left out of scoring.
CITYSCAPES_LAYOUT = {7: HORIZONTAL, 8: HORIZONTAL, 22: HORIZONTAL, 23: SKY}
CITYSCAPES_VALUES = (*range(34), 255)
CITYSCAPES_LABELS = NumberLabels(
    road=(7,),
    void=CITYSCAPES_VOID,
    values=CITYSCAPES_VALUES,
    layout=tuple(
        NONE if value in CITYSCAPES_VOID else CITYSCAPES_LAYOUT.get(value, VERTICAL)
        for value in CITYSCAPES_VALUES
    ),
)
PICTURE_ENDING, LABEL_ENDING = "_leftImg8bit", "_gtFine_labelIds.png"


def open_cityscapes(root: Path, split: str) -> Dataset:
    """ROOT/leftImg8bit/SPLIT/CITY/*_leftImg8bit.png, ROOT/gtFine/SPLIT/CITY/*_labelIds.png.

    The groups are the cities. Raises DatasetError naming the first thing that is missing.
    """
    images, labels = root / "leftImg8bit" / split, root / "gtFine" / split
    for folder in (images, labels):
        if not folder.is_dir():
            raise DatasetError(folder, "does not exist", "check the folder's layout")
    items = tuple(
        _cityscapes_item(image, labels / image.parent.name)
        for image in sorted(images.glob(f"*/*{PICTURE_ENDING}.*"))
        if is_picture(image)
    )
    if not items:
        what = f"holds no pictures CITY/*{PICTURE_ENDING}.png"
        raise DatasetError(images, what, "check the folder's layout")
    missing = [item.label for item in items if not item.label.is_file()]
    if missing:
        what = f"is missing, {len(missing)} of {len(items)} label files in all"
        raise DatasetError(missing[0], what, "every picture needs its label file")
    return Dataset("cityscapes", root, split, items, CITYSCAPES_LABELS)


def _cityscapes_item(image: Path, labels: Path) -> Item:
    name = image.stem.removesuffix(PICTURE_ENDING)
    return Item(name, image, labels / f"{name}{LABEL_ENDING}", group=image.parent.name)


# --- all of them ------------------------------------------------------------------------

KINDS: Mapping[str, Kind] = {
    **camvid.KINDS,
    "cityscapes": Kind(("val", "train"), open_cityscapes),
    "folder": Kind(("all",), open_folder),
    "idd-lite": Kind(("all",), open_idd_lite),
    kitti.NAME: Kind(kitti.SPLITS, kitti.open_kitti_road),
    "labelme": Kind(("all",), open_labelme),
    "labelme:intersection": Kind(("all",), partial(open_labelme, agreement="intersection")),
    "labelme:union": Kind(("all",), partial(open_labelme, agreement="union")),
}
