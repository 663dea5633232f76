"""The door to labelled sets: names, splits, other packages' sets, reading items."""

from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import roadtorch.base.plugins
import roadtorch.data.catalogue
from roadtorch.base.errors import DatasetError
from roadtorch.data.catalogue import dataset_kind, list_datasets, open_dataset
from roadtorch.data.dataset import Dataset, Kind, LabelledItem, Truth


def test_the_sets_that_come_along():
    assert list_datasets() == [
        *("camvid", "camvid32", "camvid32:literal", "camvid32:literal-ignore"),
        *("cityscapes", "folder", "idd-lite", "kitti-road"),
    ]
    assert all(dataset_kind(name).splits for name in list_datasets())


@pytest.mark.parametrize("name", list_datasets())
def test_every_set_says_what_is_missing_in_an_empty_folder(tmp_path, name):
    for split in dataset_kind(name).splits:
        with pytest.raises(DatasetError, match=str(tmp_path)):
            open_dataset(name, tmp_path, split)


# --- other packages ------------------------------------------------------------------------------


class BottomHalf:
    """A reader that opens no file: the lower half is road."""

    def truth(self, item: LabelledItem) -> Truth:
        road = torch.zeros(4, 6, dtype=torch.bool)
        road[2:] = True
        return Truth(road, torch.ones_like(road))


def open_foreign(root: Path, split: str) -> Dataset:
    paths = [path for path in sorted(root.glob("*.png")) if split in path.stem]
    items = tuple(LabelledItem(path.stem, path, path) for path in paths)
    return Dataset("theirs", root, split, items, BottomHalf())


FOREIGN = Kind(("day", "night"), open_foreign)
NO_KIND = open_foreign


def offer(monkeypatch: pytest.MonkeyPatch, **points: str) -> dict[str, Kind]:
    """The sets on offer when another package has these entry points."""
    found = [
        EntryPoint(name, f"tests.data.test_datasets:{value}", "roadtorch.datasets")
        for name, value in points.items()
    ]
    monkeypatch.setattr(roadtorch.base.plugins, "entry_points", lambda group: found)
    kinds = roadtorch.data.catalogue._catalogue.__wrapped__()
    monkeypatch.setattr(roadtorch.data.catalogue, "_catalogue", lambda: kinds)
    return kinds


def test_other_packages_add_sets(monkeypatch, tmp_path):
    offer(monkeypatch, theirs="FOREIGN")
    Image.fromarray(np.zeros((4, 6, 3), np.uint8)).save(tmp_path / "day_1.png")

    dataset = open_dataset("theirs", tmp_path)
    image, truth = dataset.read(dataset.items[0])

    assert (dataset.split, dataset.levels, dataset.view) == ("day", 65_536, None)
    assert image.shape == (3, 4, 6)
    assert truth.road.sum() == 12
    with pytest.raises(DatasetError, match="holds no pictures of the split night"):
        open_dataset("theirs", tmp_path, "night")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("theirs", "MISSING", "'theirs' of .* cannot be used"),
        ("theirs", "NO_KIND", "is function .name a Kind"),
        ("camvid", "FOREIGN", "camvid: is the name of another set"),
    ],
)
def test_a_broken_package_costs_only_its_own(monkeypatch, name, value, message):
    with pytest.warns(RuntimeWarning, match=message):
        kinds = offer(monkeypatch, **{name: value, "good": "FOREIGN"})

    assert kinds["good"] is FOREIGN
    assert kinds["camvid"] is not FOREIGN
