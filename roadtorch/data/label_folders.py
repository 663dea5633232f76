"""Data sets of label images in folders: your own with its conditions, IDD Lite, Cityscapes."""

import csv
import difflib
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from unicodedata import normalize

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.errors import DatasetError
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.data.label_images import (
    NumberLabels,
    decode_labels,
    is_image_file,
    list_images,
    pair_files,
    read_labels,
    require_labels,
)
from roadtorch.data.masks import MASK_VALUES, Mask, MaskValues, read_masks
from roadtorch.layout.classes import HORIZONTAL, SKY, UNLABELLED, VERTICAL

# --- folder -----------------------------------------------------------------------------

LABEL_SOURCES = ("masks", "road", "coco.json", "annotations/instances_default.json")
"""Folders or COCO files beside a folder of images, the first of which has its masks."""

ROAD_FOLDER_VALUES: MaskValues = ("1",), ("255",)

LAYOUT_CODING = NumberLabels(
    road=(),
    void=(UNLABELLED,),
    values=(SKY, VERTICAL, HORIZONTAL, UNLABELLED),
    layout=(SKY, VERTICAL, HORIZONTAL, UNLABELLED),
)


@dataclass(frozen=True)
class FolderLabels:
    """Reader of your own labels; masks: by the name of the item.

    Layouts, for some images: 0 sky, 1 vertical, 2 horizontal, 255 void.
    """

    masks: Mapping[str, Mask] = field(default_factory=dict)

    def truth(self, item: LabelledItem) -> Truth:
        """Read the item's labels; DatasetError where they cannot be read."""
        truth = self.masks[item.name].truth
        for path in item.extra:
            labels = read_labels(path, (truth.road.shape[0], truth.road.shape[1]))
            truth = replace(truth, layout=decode_labels(labels, LAYOUT_CODING, path).layout)
        return truth


def open_folder(
    root: Path, split: str, road: Sequence[str] = (), void: Sequence[str] = ()
) -> Dataset:
    """Open ROOT/images with one of ``LABEL_SOURCES``, or folders of this layout as groups.

    Images of groups are called GROUP/NAME. Images without a mask are left out, as the summary says.
    Conditions come from ROOT/pictures.csv, if it exists. road, void: values as in ``read_masks``.
    Raises DatasetError naming a missing folder, unknown values, or a mistake in that table.
    """
    folders: dict[str | None, Path] = {None: root}
    if not (root / "images").is_dir():
        folders = {path.parent.name: path.parent for path in sorted(root.glob("*/images"))}
    masks, items, summaries = dict[str, Mask](), list[LabelledItem](), list[str]()
    for group, folder in folders.items():
        names = {path.name: path for path in list_images(folder / "images")}
        sources = [folder / source for source in LABEL_SOURCES]
        source = next((path for path in sources if path.exists()), sources[0])
        defaults = ROAD_FOLDER_VALUES if source.name == "road" else MASK_VALUES
        if not source.exists():
            raise DatasetError(source, "does not exist", f"give {', '.join(LABEL_SOURCES)}")
        folder_masks, summary = read_masks(source, names, road, void, defaults, requires_road=False)
        summaries.append(f"{source}: {summary}")
        for mask in folder_masks:
            name = f"{group}/{mask.image.stem}" if group else mask.image.stem
            layout = folder / "layout" / f"{mask.image.stem}.png"
            extra = (layout,) if layout.is_file() else ()
            if (first := masks.get(name)) is not None:
                message = f"has the name of {first.image.name}"
                raise DatasetError(mask.image, message, "rename one of the images")
            items.append(LabelledItem(name, mask.image, mask.file, group, extra))
            masks[name] = mask
    if not items:
        message = "has no folder images, and no subfolder has one"
        raise DatasetError(root, message, "check the folder's layout")
    dataset = Dataset(
        "folder", root, split, tuple(items), FolderLabels(masks), summary="\n".join(summaries)
    )
    table = root / CONDITIONS_FILE
    return add_conditions(dataset, table) if table.is_file() else dataset


# --- conditions -------------------------------------------------------------------------

# A table of conditions is CSV with the columns ``file`` (the image's file name), ``condition``
# (words, any number of them: "night rain") and, for a set with groups, ``name`` (the group). Other
# columns are ignored; images that it does not list have no condition.

CONDITIONS_FILE = "pictures.csv"  # in the folder of a set


def add_conditions(dataset: Dataset, path: Path) -> Dataset:
    """Return the data set with the conditions that a table lists for its images.

    Raises DatasetError naming the table, and the line where there is one, for a file that cannot be
    read, lacks a column, names an image that the set does not have, or names one twice.
    """
    keys = [_item_key(item.group, item.image.name) for item in dataset.items]
    columns = ["name", "file", "condition"] if dataset.groups() else ["file", "condition"]
    conditions: dict[str, tuple[str, ...]] = {}
    for line, row in _read_rows(path, columns):
        where = f"{path}, line {line}"
        key = _item_key(row["name"] if dataset.groups() else None, row["file"])
        if key not in keys:
            near = difflib.get_close_matches(key, keys, n=3, cutoff=0.5)
            hint = f"did you mean {', '.join(near)}?" if near else "fix or remove that line"
            raise DatasetError(where, f"there is no image {key}", hint)
        if key in conditions:
            raise DatasetError(where, f"names {key} a second time", "keep one of the two lines")
        conditions[key] = tuple(dict.fromkeys(row["condition"].split()))
    pairs = zip(keys, dataset.items, strict=True)
    items = (replace(item, conditions=conditions.get(key, ())) for key, item in pairs)
    return replace(dataset, items=tuple(items))


def _item_key(group: str | None, file: str) -> str:
    """Return an image's name in a table of conditions: GROUP/FILE, or FILE without groups."""
    return normalize("NFC", f"{group}/{file}" if group else file)


def _read_rows(path: Path, columns: list[str]) -> Iterator[tuple[int, Mapping[str, str]]]:
    """Yield line number and cells of each row below the header."""
    try:
        text = read_regular(path).decode("utf-8-sig")
        table = csv.DictReader(io.StringIO(text, newline=""), restval="", strict=True)
        missing = [name for name in columns if name not in (table.fieldnames or ())]
        if missing:
            message = f"has no column {' and no column '.join(missing)}"
            raise DatasetError(path, message, f"its first line must name {', '.join(columns)}")
        for row in table:
            if None in row:
                where = f"{path}, line {table.line_num}"
                raise DatasetError(where, "has more cells than the header", "quote or remove them")
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
