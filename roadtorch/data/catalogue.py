"""The labelled data sets by name."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from roadtorch.base.errors import ConfigError, DatasetError, unknown_name_error
from roadtorch.data import camvid, kitti_road
from roadtorch.data.corrections import open_corrections
from roadtorch.data.dataset import Dataset, DatasetFormat
from roadtorch.data.label_folders import open_cityscapes, open_folder, open_idd_lite

DATASET_FORMATS: Mapping[str, DatasetFormat] = {
    **camvid.CAMVID_FORMATS,
    "corrections": DatasetFormat(("all",), open_corrections),
    "cityscapes": DatasetFormat(("val", "train"), open_cityscapes),
    "folder": DatasetFormat(("all",), open_folder),
    "idd-lite": DatasetFormat(("all",), open_idd_lite),
    kitti_road.KITTI_NAME: DatasetFormat(kitti_road.KITTI_SPLITS, kitti_road.open_kitti_road),
}


def open_dataset(
    name: str, root: Path, split: str | None = None, **values: Sequence[str]
) -> Dataset:
    """Open a labelled data set, one of ``DATASET_FORMATS``, in its folder ``root``.

    split: one of its splits; the first one by default. values: of ``road`` and ``void``, if any, in
    the masks of ``folder``.

    Raises:
        ConfigError: for an unknown name or split.
        DatasetError: for an incomplete or empty data set.
    """
    if name not in DATASET_FORMATS:
        raise unknown_name_error("data set", name, DATASET_FORMATS)
    dataset_format = DATASET_FORMATS[name]
    splits = dataset_format.splits
    if split is not None and split not in splits:
        raise unknown_name_error(f"split of {name}", split, splits)
    if not root.is_dir():
        raise DatasetError(root, "is not a folder", "give the one with the images and labels")
    split = split or splits[0]
    values = {key: value for key, value in values.items() if value}
    if values and dataset_format.open is not open_folder:
        raise ConfigError(f"--{next(iter(values))}", f"is not for the set {name}", "leave it out")
    dataset = dataset_format.open(root, split, **values)
    if not dataset.items:
        raise DatasetError(root, f"holds no images of the split {split}", "choose another split")
    return dataset


def open_dataset_spec(text: str) -> Dataset:
    """Open the data set of ``NAME:ROOT``; names (``camvid32:literal``) and roots may have colons.

    Raises ConfigError for any other text, DatasetError for an incomplete data set.
    """
    longest_first = sorted(DATASET_FORMATS, key=len, reverse=True)
    name = next((name for name in longest_first if text.startswith(f"{name}:")), None)
    if name is None:
        message = "does not begin with a data set and a colon"
        raise ConfigError(text, message, "write NAME:ROOT, for example camvid:data/camvid")
    return open_dataset(name, Path(text.removeprefix(f"{name}:")))
