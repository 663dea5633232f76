"""Sets that are two folders, one of pictures and one of labels: any of your own, and IDD Lite."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from roadtorch.data import conditions
from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.data.labels import NumberLabels, decode_labels, pairs, read_labels
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
