"""CamVid: in the 11 classes that most papers use, and in its original 32 colours.

Brostow, Fauqueur, Cipolla, Pattern Recognition Letters 30(2), 2009. Every figure on CamVid
depends on how the 32 entries are mapped to road and layout; the name of the set tells which
mapping is used:

``camvid``, ``camvid32``        the 11 classes of the 480×360 release (SegNet's)
``camvid32:literal``            P2's sentence: sky; road and sidewalk; all 29 others vertical
``camvid32:literal-ignore``     the same without void
"""

import re
from collections.abc import Iterator
from functools import partial
from itertools import starmap
from pathlib import Path

from roadtorch.base.errors import DatasetError
from roadtorch.data.dataset import Dataset, DatasetFormat, LabelledItem
from roadtorch.data.label_images import ColourLabels, NumberLabels, pair_files
from roadtorch.layout.classes import HORIZONTAL, SKY, UNLABELLED, VERTICAL

DRIVE_NAME_LENGTH = 6  # CamVid names begin with the drive: 0001TP, 0006R0, 0016E5, Seq05V

# --- eleven classes ---------------------------------------------------------------------

CLASSES11 = (
    *("sky", "building", "pole", "road", "pavement", "tree"),
    *("sign", "fence", "car", "pedestrian", "bicyclist", "void"),
)

CAMVID_LABELS = NumberLabels(
    road=(CLASSES11.index("road"),),
    void=(CLASSES11.index("void"),),
    values=tuple(range(len(CLASSES11))),
    layout=(SKY, *(VERTICAL,) * 2, *(HORIZONTAL,) * 2, *(VERTICAL,) * 6, UNLABELLED),
)

CAMVID_SPLITS = {"dev": ("train", "val"), "train": ("train",), "val": ("val",), "test": ("test",)}


def open_camvid(root: Path, split: str) -> Dataset:
    """Open CamVid in the 11-class layout: ROOT/train and ROOT/trainannot, likewise val and test.

    The test split, which P2's Figs. 4 and 6 show, is not part of ``dev`` and may be missing.
    """
    items = tuple(
        _make_item(image, label)
        for part in CAMVID_SPLITS[split]
        for image, label in pair_files(root / part, root / f"{part}annot")
    )
    return Dataset("camvid", root, split, items, CAMVID_LABELS)


def _make_item(image: Path, label: Path) -> LabelledItem:
    return LabelledItem(image.stem, image, label, group=image.stem[:DRIVE_NAME_LENGTH])


# --- 32 colours -------------------------------------------------------------------------

# Colour, name, and class in the 480×360 release: measured by comparing it with the full-size
# labels of 66 frames, as published groupings of the 32 contradict each other and the release
# (road shoulder is road there, and seven rare entries are void).
COLOURS32 = (
    ((64, 128, 64), "Animal", "void"),
    ((192, 0, 128), "Archway", "void"),
    ((0, 128, 192), "Bicyclist", "bicyclist"),
    ((0, 128, 64), "Bridge", "void"),
    ((128, 0, 0), "Building", "building"),
    ((64, 0, 128), "Car", "car"),
    ((64, 0, 192), "CartLuggagePram", "void"),
    ((192, 128, 64), "Child", "void"),
    ((192, 192, 128), "Column_Pole", "pole"),
    ((64, 64, 128), "Fence", "fence"),
    ((128, 0, 192), "LaneMkgsDriv", "road"),
    ((192, 0, 64), "LaneMkgsNonDriv", "road"),
    ((128, 128, 64), "Misc_Text", "sign"),
    ((192, 0, 192), "MotorcycleScooter", "bicyclist"),
    ((128, 64, 64), "OtherMoving", "void"),
    ((64, 192, 128), "ParkingBlock", "pavement"),
    ((64, 64, 0), "Pedestrian", "pedestrian"),
    ((128, 64, 128), "Road", "road"),
    ((128, 128, 192), "RoadShoulder", "road"),
    ((0, 0, 192), "Sidewalk", "pavement"),
    ((192, 128, 128), "SignSymbol", "sign"),
    ((128, 128, 128), "Sky", "sky"),
    ((64, 128, 192), "SUVPickupTruck", "car"),
    ((0, 0, 64), "TrafficCone", "void"),
    ((0, 64, 64), "TrafficLight", "sign"),
    ((192, 64, 128), "Train", "void"),
    ((128, 128, 0), "Tree", "tree"),
    ((192, 128, 192), "Truck_Bus", "car"),
    ((64, 0, 64), "Tunnel", "void"),
    ((192, 192, 0), "VegetationMisc", "tree"),
    ((0, 0, 0), "Void", "void"),
    ((64, 192, 0), "Wall", "building"),
)

NAMES32 = tuple(name for _, name, _ in COLOURS32)

LITERAL_LAYOUT = {"Sky": SKY, "Road": HORIZONTAL, "Sidewalk": HORIZONTAL}


def _map_by_class() -> NumberLabels:
    """Map the colours through the 11 classes, by which lane markings and shoulders are road."""
    classes = [CLASSES11.index(name) for _, _, name in COLOURS32]
    values = range(len(classes))
    return NumberLabels(
        road=tuple(i for i in values if classes[i] in CAMVID_LABELS.road),
        void=tuple(i for i in values if classes[i] in CAMVID_LABELS.void),
        values=tuple(values),
        layout=tuple(CAMVID_LABELS.layout[index] for index in classes),
    )


def _map_literally(void: tuple[str, ...]) -> NumberLabels:
    """Map the colours as P2 writes (ECCV 2012, §6.1): only ``Road`` is road."""
    layout = LITERAL_LAYOUT | dict.fromkeys(void, UNLABELLED)
    return NumberLabels(
        road=(NAMES32.index("Road"),),
        void=tuple(map(NAMES32.index, void)),
        values=tuple(range(len(NAMES32))),
        layout=tuple(layout.get(name, VERTICAL) for name in NAMES32),
    )


CLASS_MAPPINGS = {
    "camvid32": _map_by_class(),
    "camvid32:literal": _map_literally(void=()),
    "camvid32:literal-ignore": _map_literally(void=("Void",)),
}

# Folders of images and of labels in the copies of CamVid that people have.
FOLDERS32 = (
    ("images", "labels"),
    ("701_StillsRaw_full", "LabeledApproved_full"),
    ("images/701_StillsRaw_full", "labels"),
    *((part, f"{part}_labels") for part in ("train", "val", "test")),
)

SPLITS32 = {"all": ("train", "val", "test"), **CAMVID_SPLITS}


def segnet_split(name: str) -> str:
    """Return SegNet's split (367, 101, 233 frames) by a frame's name; DatasetError for others."""
    parts = re.fullmatch(r"(0001TP|0006R0|0016E5|Seq05VD)_f?(\d+)", name)
    if parts is None:
        hint = "name frames like 0016E5_07959"
        raise DatasetError(name, "is not the name of a CamVid frame", hint)
    drive, frame = parts[1], int(parts[2])
    if drive == "Seq05VD" or (drive == "0001TP" and frame >= 8550):
        return "test"
    return "val" if drive == "0016E5" and 7959 <= frame <= 8159 else "train"


def open_camvid32(root: Path, split: str, name: str = "camvid32") -> Dataset:
    """Open CamVid in its original colours: ROOT/images/NAME.*, ROOT/labels/NAME_L.png.

    ROOT/701_StillsRaw_full with ROOT/LabeledApproved_full, as published, and ROOT/train with
    ROOT/train_labels and so on are read too. The frames' names decide on the split, not their
    folders. name: a key of ``CLASS_MAPPINGS``.
    """
    frames = _find_items32(root)
    items = tuple(frame for frame in frames if segnet_split(frame.name) in SPLITS32[split])
    labels = ColourLabels(tuple(colour for colour, _, _ in COLOURS32), CLASS_MAPPINGS[name])
    return Dataset(name, root, split, items, labels)


def _find_items32(root: Path) -> Iterator[LabelledItem]:
    present = [
        (root / images, root / labels)
        for images, labels in FOLDERS32
        if (root / images).is_dir() and (root / labels).is_dir()
    ]
    if not present:
        folders = ", ".join(f"{images} + {labels}" for images, labels in FOLDERS32)
        raise DatasetError(root, "holds no CamVid in 32 colours", f"known folders: {folders}")
    # A folder that holds the published folder is not a folder of images itself.
    nested = {images.parent for images, _ in present}
    for images, labels in present:
        if images not in nested:
            yield from starmap(_make_item, pair_files(images, labels, "_L.png"))


CAMVID_FORMATS = {
    "camvid": DatasetFormat(tuple(CAMVID_SPLITS), open_camvid),
    **{
        name: DatasetFormat(tuple(SPLITS32), partial(open_camvid32, name=name))
        for name in CLASS_MAPPINGS
    },
}
