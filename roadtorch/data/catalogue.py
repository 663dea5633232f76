"""Registry of the labelled data sets by name.

Other packages register theirs through the entry-point group ``roadtorch.datasets``: the entry
point has the name of the data set and refers to a ``DatasetFormat``.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from roadtorch.base.errors import ConfigError, DatasetError, unknown_name_error
from roadtorch.base.plugins import load_plugins
from roadtorch.data import camvid, kitti_road
from roadtorch.data.corrections import open_corrections
from roadtorch.data.dataset import Dataset, DatasetFormat
from roadtorch.data.label_folders import open_cityscapes, open_folder, open_idd_lite

ENTRY_POINT_GROUP = "roadtorch.datasets"

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
    """Open a labelled data set, one of ``list_datasets()``, in its folder ``root``.

    split: one of its splits; the first one by default. values: of ``road`` and ``void``, if any, in
    the masks of ``folder``.

    Raises:
        ConfigError: for an unknown name or split.
        DatasetError: for an incomplete or empty data set.
    """
    if name not in _catalogue():
        raise unknown_name_error("data set", name, _catalogue())
    dataset_format = _catalogue()[name]
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
    longest_first = sorted(list_datasets(), key=len, reverse=True)
    name = next((name for name in longest_first if text.startswith(f"{name}:")), None)
    if name is None:
        message = "does not begin with a data set and a colon"
        raise ConfigError(text, message, "write NAME:ROOT, for example camvid:data/camvid")
    return open_dataset(name, Path(text.removeprefix(f"{name}:")))


def list_datasets() -> list[str]:
    """Return the names of all data sets, sorted, including those of other packages."""
    return sorted(_catalogue())


@cache
def _catalogue() -> dict[str, DatasetFormat]:
    formats = dict(DATASET_FORMATS)

    def add(name: str, value: object) -> None:
        if name in formats:
            raise ConfigError(name, "is the name of another set", "choose a new name")
        if not isinstance(value, DatasetFormat):
            raise ConfigError(name, f"is {type(value).__name__}", "refer to a DatasetFormat")
        formats[name] = value

    load_plugins(ENTRY_POINT_GROUP, "data set", add)
    return formats
