"""Cityscapes: where its files lie and what its labels mean."""

from pathlib import Path

from roadtorch.data.dataset import Dataset, Item
from roadtorch.data.labels import NumberLabels, is_picture
from roadtorch.errors import DatasetError
from roadtorch.layout.classes import HORIZONTAL, SKY, UNLABELLED, VERTICAL

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
        UNLABELLED if value in CITYSCAPES_VOID else CITYSCAPES_LAYOUT.get(value, VERTICAL)
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
