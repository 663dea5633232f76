"""Sets of label pictures in folders: any of your own, IDD Lite and Cityscapes."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from roadtorch.data import conditions
from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.data.labels import NumberLabels, decode_labels, is_picture, pairs, read_labels
from roadtorch.errors import DatasetError
from roadtorch.layout.classes import HORIZONTAL, SKY, UNLABELLED, VERTICAL

# --- folder -----------------------------------------------------------------------------

MASKS = NumberLabels(
    road=(1, 255), void=(127, 128), values=(0, 1, 127, 128, 255), exclusive=(1, 255)
)
ROAD = NumberLabels(
    road=(1,),
    void=(255,),
    values=(0, 1, 255),
)
LAYOUT = NumberLabels(
    road=(),
    void=(UNLABELLED,),
    values=(SKY, VERTICAL, HORIZONTAL, UNLABELLED),
    layout=(SKY, VERTICAL, HORIZONTAL, UNLABELLED),
)


@dataclass(frozen=True)
class FolderLabels:
    """The truth in a folder of one's own, by the name of the folder that holds it.

    masks: 0 not road, 255 or 1 road, 127 or 128 void. road: 0, 1, void 255. layout, beside
    either of them and only for some pictures: 0 sky, 1 vertical, 2 horizontal, 255 void.
    """

    def truth(self, item: Item) -> Truth:
        """Read the item's labels; DatasetError naming and counting unknown numbers."""
        truth = (ROAD if item.label.parent.name == "road" else MASKS).truth(item)
        for path in item.extra:
            labels = read_labels(path)
            if labels.shape != truth.road.shape:
                what = f"is {labels.shape[1]} by {labels.shape[0]} pixels, unlike {item.label.name}"
                raise DatasetError(path, what, "labels must have the size of the picture")
            truth = replace(truth, layout=decode_labels(labels, LAYOUT, path).layout)
        return truth


def open_folder(root: Path, split: str) -> Dataset:
    """ROOT/images with ROOT/masks or ROOT/road; or folders of this kind, which are the groups.

    Pictures of groups are called GROUP/NAME. Conditions come from ROOT/pictures.csv, if it is
    there. Raises DatasetError naming what is missing, or what is wrong in that table.
    """
    if (root / "images").is_dir():
        items = tuple(_labelled(root, None))
    else:
        groups = [path.parent for path in sorted(root.glob("*/images")) if path.is_dir()]
        items = tuple(item for group in groups for item in _labelled(group, group.name))
    if not items:
        what = "has no folder images, nor folders that have one"
        raise DatasetError(root, what, "check the folder's layout")
    found = Dataset("folder", root, split, items, FolderLabels())
    table = root / conditions.FILE
    return conditions.with_conditions(found, table) if table.is_file() else found


def _labelled(folder: Path, group: str | None) -> Iterator[Item]:
    labels = "road" if not (folder / "masks").is_dir() and (folder / "road").is_dir() else "masks"
    for image, label in pairs(folder / "images", folder / labels):
        name = f"{group}/{image.stem}" if group else image.stem
        layout = folder / "layout" / label.name
        yield Item(name, image, label, group, (layout,) if layout.is_file() else ())


# --- IDD Lite ---------------------------------------------------------------------------

IDD_LABELS = NumberLabels(
    road=(0,),
    void=(255,),
    values=(*range(7), 255),
    # drivable, non-drivable, living things, vehicles, roadside objects, far objects, sky
    layout=(HORIZONTAL, HORIZONTAL, *(VERTICAL,) * 4, SKY, UNLABELLED),
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
    items = []
    for image in filter(is_picture, sorted(images.glob(f"*/*{PICTURE_ENDING}.*"))):
        name, city = image.stem.removesuffix(PICTURE_ENDING), image.parent.name
        items.append(Item(name, image, labels / city / f"{name}{LABEL_ENDING}", group=city))
    if not items:
        what = f"holds no pictures CITY/*{PICTURE_ENDING}.png"
        raise DatasetError(images, what, "check the folder's layout")
    missing = [item.label for item in items if not item.label.is_file()]
    if missing:
        what = f"is missing, {len(missing)} of {len(items)} label files in all"
        raise DatasetError(missing[0], what, "every picture needs its label file")
    return Dataset("cityscapes", root, split, tuple(items), CITYSCAPES_LABELS)
