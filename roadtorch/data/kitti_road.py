"""KITTI road benchmark: its files, their names, and scoring in bird's-eye view.

Fritsch, Kuehnl, Geiger (ITSC 2013). Three categories: um, urban with marked lanes; umm, with
several marked lanes; uu, unmarked. The benchmark scores maps of 8 bits in bird's-eye view; scores
in image space are not comparable, as far pixels weigh much less there.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from torch import Tensor

from roadtorch.base.errors import ConfigError, DatasetError
from roadtorch.camera.birds_eye import warp_to_birds_eye
from roadtorch.camera.calibration import read_calibration
from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.data.label_images import ColourLabels, NumberLabels, list_images, require_labels

KITTI_NAME = "kitti-road"
KITTI_SPLITS = ("road", "lane")  # the whole road, or only the ego lane (category um)
KITTI_LEVELS = 256
LANE_CATEGORIES = ("um",)

# Blue is road, red is valid; road outside the valid area is not scored.
KITTI_COLOURS = ColourLabels(
    colours=((0, 0, 0), (255, 0, 0), (255, 0, 255), (0, 0, 255)),
    numbers=NumberLabels(road=(2,), void=(0, 3), values=(0, 1, 2, 3)),
)

# --- names ------------------------------------------------------------------------------


def result_name(name: str, kind: str = "road") -> str:
    """Return the name of an image's label file and of its map for the server: um_road_000012."""
    category, number = split_name(name)
    return f"{category}_{kind}_{number}"


def split_name(name: str) -> tuple[str, str]:
    """Split an image's name, as um_000012, into category and number; DatasetError for others."""
    parts = re.fullmatch(r"([a-z]+)_(\d+)", name)
    if parts is None:
        hint = "name images CATEGORY_NUMBER, such as um_000012"
        raise DatasetError(name, "is not the name of a KITTI road image", hint)
    return parts[1], parts[2]


def find_kitti_folder(root: Path, part: str) -> Path:
    """Return the folder that holds image_2: ROOT or ROOT/part; DatasetError without one."""
    for folder in (root, root / part):
        if (folder / "image_2").is_dir():
            return folder
    hint = f"give the folder that holds image_2 or {part}/image_2"
    raise DatasetError(root / "image_2", "does not exist", hint)


# --- the labelled set -------------------------------------------------------------------


def open_kitti_road(root: Path, split: str) -> Dataset:
    """Open the training images: ROOT/image_2 and ROOT/gt_image_2, or both in ROOT/training.

    split: "road", every image; "lane", those of um with the ego lane as road. The groups are the
    categories. Scored in image space, with the benchmark's 256 levels. Raises DatasetError for a
    missing folder or label file.
    """
    folder, items = find_kitti_folder(root, "training"), []
    for image in list_images(folder / "image_2"):
        category, _ = split_name(image.stem)
        if split == "road" or category in LANE_CATEGORIES:
            label = folder / "gt_image_2" / f"{result_name(image.stem, split)}.png"
            items.append(LabelledItem(image.stem, image, label, group=category))
    require_labels([item.label for item in items])
    return Dataset(KITTI_NAME, root, split, tuple(items), KITTI_COLOURS, KITTI_LEVELS)


@dataclass(frozen=True)
class BirdsEyeView:
    """Bird's-eye view by the images' calibration files; calib: their folder."""

    calib: Path
    name: ClassVar[str] = "bird's-eye view"

    def __call__(self, item: LabelledItem, values: Tensor) -> Tensor:
        """Map (..., H, W) of the item's image to (..., 800, 400), same dtype; 0 in invisible cells.

        Raises DatasetError naming a calibration file that is missing or broken.
        """
        # Not cached: reading takes a third of a millisecond, and is never out of date.
        return warp_to_birds_eye(values, read_calibration(self.calib / f"{item.name}.txt"))


def use_birds_eye_view(dataset: Dataset) -> Dataset:
    """Return the data set scored in bird's-eye view, as the benchmark does, by ROOT/calib/NAME.txt.

    Invisible cells are void. Raises ConfigError for a set other than KITTI's, DatasetError when
    there is no folder calib.
    """
    if dataset.name != KITTI_NAME:
        hint = f"only {KITTI_NAME} has calibration files"
        raise ConfigError(dataset.name, "has no bird's-eye view", hint)
    folder = find_calibration_folder(find_kitti_folder(dataset.root, "training"))
    return replace(dataset, scoring_space=BirdsEyeView(folder))


def find_calibration_folder(folder: Path) -> Path:
    """Return the folder of calibration files beside image_2; DatasetError when there is none."""
    if not (folder / "calib").is_dir():
        hint = "bird's-eye view needs calibration files"
        raise DatasetError(folder / "calib", "does not exist", hint)
    return folder / "calib"
