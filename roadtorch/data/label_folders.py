"""Data sets of label images in folders: your own with its conditions, IDD Lite, Cityscapes."""

import csv
import difflib
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from unicodedata import normalize

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.errors import DatasetError
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.data.label_images import (
    NumberLabels,
    decode_labels,
    is_image_file,
    pair_files,
    read_labels,
    require_labels,
)
from roadtorch.layout.classes import HORIZONTAL, SKY, UNLABELLED, VERTICAL

# --- folder -----------------------------------------------------------------------------

MASK_CODING = NumberLabels(
    road=(1, 255), void=(127, 128), values=(0, 1, 127, 128, 255), exclusive=(1, 255)
)
ROAD_CODING = NumberLabels(road=(1,), void=(255,), values=(0, 1, 255))
LAYOUT_CODING = NumberLabels(
    road=(),
    void=(UNLABELLED,),
    values=(SKY, VERTICAL, HORIZONTAL, UNLABELLED),
    layout=(SKY, VERTICAL, HORIZONTAL, UNLABELLED),
)


@dataclass(frozen=True)
class FolderLabels:
    """Reader of your own labels; the name of the folder that holds them tells their coding.

    masks: 0 not road, 255 or 1 road, 127 or 128 void. road: 0, 1, void 255. layout, beside either
    of them and for some images only: 0 sky, 1 vertical, 2 horizontal, 255 void.
    """

    def truth(self, item: LabelledItem) -> Truth:
        """Read the item's labels; DatasetError naming and counting unknown numbers."""
        truth = (ROAD_CODING if item.label.parent.name == "road" else MASK_CODING).truth(item)
        for path in item.extra:
            labels = read_labels(path)
            if labels.shape != truth.road.shape:
                size = f"{labels.shape[1]} by {labels.shape[0]} pixels"
                hint = "labels must have the size of the image"
                raise DatasetError(path, f"is {size}, unlike {item.label.name}", hint)
            truth = replace(truth, layout=decode_labels(labels, LAYOUT_CODING, path).layout)
        return truth


def open_folder(root: Path, split: str) -> Dataset:
    """Open ROOT/images with ROOT/masks or ROOT/road, or folders of this layout as groups.

    Images of groups are called GROUP/NAME. Conditions come from ROOT/pictures.csv, if it exists.
    Raises DatasetError naming a missing file, or a mistake in that table.
    """
    if (root / "images").is_dir():
        items = tuple(_find_items(root, None))
    else:
        groups = [path.parent for path in sorted(root.glob("*/images")) if path.is_dir()]
        items = tuple(item for group in groups for item in _find_items(group, group.name))
    if not items:
        message = "has no folder images, and no subfolder has one"
        raise DatasetError(root, message, "check the folder's layout")
    dataset = Dataset("folder", root, split, items, FolderLabels())
    table = root / CONDITIONS_FILE
    return add_conditions(dataset, table) if table.is_file() else dataset


def _find_items(folder: Path, group: str | None) -> Iterator[LabelledItem]:
    labels = "road" if not (folder / "masks").is_dir() and (folder / "road").is_dir() else "masks"
    for image, label in pair_files(folder / "images", folder / labels):
        name = f"{group}/{image.stem}" if group else image.stem
        layout = folder / "layout" / label.name
        yield LabelledItem(name, image, label, group, (layout,) if layout.is_file() else ())


# --- conditions -------------------------------------------------------------------------

# A table of conditions is CSV with the columns ``file`` (the image's file name), ``condition``
# (words, any number of them: "night rain") and, for a set with groups, ``name`` (the group). Other
# columns are ignored; images that it does not list have no condition.

CONDITIONS_FILE = "pictures.csv"  # in the folder of a set
_ItemKey = tuple[str, str]  # group of an image ("" in a set without groups) and its file name


def add_conditions(dataset: Dataset, path: Path) -> Dataset:
    """Return the data set with the conditions that a table lists for its images.

    Raises DatasetError naming the table, and the line where there is one, for a file that cannot be
    read, lacks a column, names an image that the set does not have, or names one twice.
    """
    images = {_item_key(item): item for item in dataset.items}
    columns = ["name", "file", "condition"] if dataset.groups() else ["file", "condition"]
    conditions: dict[_ItemKey, tuple[str, ...]] = {}
    for line, row in _read_rows(path, columns):
        key = (row["name"] if dataset.groups() else "", normalize("NFC", row["file"]))
        where, name = f"{path}, line {line}", _format_key(key)
        if key not in images:
            near = difflib.get_close_matches(name, map(_format_key, images), n=3, cutoff=0.5)
            hint = f"did you mean {', '.join(near)}?" if near else "fix or remove that line"
            raise DatasetError(where, f"there is no image {name}", hint)
        if key in conditions:
            raise DatasetError(where, f"names {name} a second time", "keep one of the two lines")
        conditions[key] = tuple(dict.fromkeys(row["condition"].split()))
    items = (
        replace(item, conditions=conditions.get(_item_key(item), ())) for item in dataset.items
    )
    return replace(dataset, items=tuple(items))


def _item_key(item: LabelledItem) -> _ItemKey:
    return item.group or "", normalize("NFC", item.image.name)


def _format_key(key: _ItemKey) -> str:
    return "/".join(filter(None, key))


def _read_rows(path: Path, columns: list[str]) -> Iterator[tuple[int, Mapping[str, str]]]:
    """Yield line number and cells of each row below the header."""
    try:
        text = read_regular(path).decode("utf-8-sig")
        table = csv.DictReader(io.StringIO(text, newline=""), restval="")
        missing = [name for name in columns if name not in (table.fieldnames or ())]
        if missing:
            message = f"has no column {' and no column '.join(missing)}"
            raise DatasetError(path, message, f"its first line must name {', '.join(columns)}")
        for row in table:
            yield table.line_num, row
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DatasetError(path, f"cannot be read: {reason(error)}", "give a CSV file") from None


# --- IDD Lite ---------------------------------------------------------------------------

IDD_LABELS = NumberLabels(
    road=(0,),
    void=(255,),
    values=(*range(7), 255),
    # drivable, non-drivable, living things, vehicles, roadside objects, far objects, sky
    layout=(HORIZONTAL, HORIZONTAL, *(VERTICAL,) * 4, SKY, UNLABELLED),
)


def open_idd_lite(root: Path, split: str) -> Dataset:
    """Open IDD Lite, seven classes: ROOT/images, ROOT/labels. Road is "drivable"."""
    items = tuple(
        LabelledItem(image.stem, image, label)
        for image, label in pair_files(root / "images", root / "labels")
    )
    return Dataset("idd-lite", root, split, items, IDD_LABELS)


# --- Cityscapes -------------------------------------------------------------------------

# Cordts et al., CVPR 2016; numbers, names and unscored classes as in its own scripts.
# -1, the licence plate, would be 255 in a byte.
CITYSCAPES_VOID = (*range(7), 9, 10, 14, 15, 16, 18, 29, 30, 255)

# Road, sidewalk and terrain: "all kinds of horizontal vegetation, soil or sand" by its
# definition. Parking and rail track would be horizontal too, but are not scored.
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

CITYSCAPES_IMAGE_ENDING, CITYSCAPES_LABEL_ENDING = "_leftImg8bit", "_gtFine_labelIds.png"


def open_cityscapes(root: Path, split: str) -> Dataset:
    """Open ROOT/leftImg8bit/SPLIT/CITY/*_leftImg8bit.png, ROOT/gtFine/SPLIT/CITY/*_labelIds.png.

    The groups are the cities. Raises DatasetError naming the first missing file.
    """
    images, labels = root / "leftImg8bit" / split, root / "gtFine" / split
    for folder in (images, labels):
        if not folder.is_dir():
            raise DatasetError(folder, "does not exist", "check the folder's layout")
    items = []
    for image in filter(is_image_file, sorted(images.glob(f"*/*{CITYSCAPES_IMAGE_ENDING}.*"))):
        name, city = image.stem.removesuffix(CITYSCAPES_IMAGE_ENDING), image.parent.name
        label = labels / city / f"{name}{CITYSCAPES_LABEL_ENDING}"
        items.append(LabelledItem(name, image, label, group=city))
    if not items:
        message = f"holds no images CITY/*{CITYSCAPES_IMAGE_ENDING}.png"
        raise DatasetError(images, message, "check the folder's layout")
    require_labels([item.label for item in items])
    return Dataset("cityscapes", root, split, tuple(items), CITYSCAPES_LABELS)
