"""Sets that are two folders, one of pictures and one of labels: any of your own, and IDD Lite."""

from pathlib import Path

from roadtorch.data.dataset import Dataset, Item
from roadtorch.data.labels import NumberLabels, pairs
from roadtorch.layout.classes import HORIZONTAL, SKY, UNLABELLED, VERTICAL

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
    layout=(HORIZONTAL, HORIZONTAL, *(VERTICAL,) * 4, SKY, UNLABELLED),
)


def open_idd_lite(root: Path, split: str) -> Dataset:
    """IDD Lite, seven classes: ROOT/images, ROOT/labels. Road is "drivable"."""
    items = tuple(
        Item(image.stem, image, label) for image, label in pairs(root / "images", root / "labels")
    )
    return Dataset("idd-lite", root, split, items, IDD_LABELS)
