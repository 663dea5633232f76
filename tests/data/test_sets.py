"""Folders, IDD Lite, Cityscapes, and the documented example of somebody's own set."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, Item, Kind
from roadtorch.data.labels import read_labels
from roadtorch.errors import DatasetError
from tests.data.conftest import write_png

DOCUMENT = Path(__file__).resolve().parents[2] / "docs/evaluation.md"


FOLDER = ("folder", "images/a", "masks/a")
ULM = "val/ulm/ulm_000001_000019"
SCORED = [7, 8, 11, 12, 13, 17, *range(19, 29), 31, 32, 33]  # the 19 of Cityscapes' own evaluation
CITY_LAYOUT = [{7: 2, 8: 2, 22: 2, 23: 0}.get(n, 1) if n in SCORED else 255 for n in range(35)]


@pytest.mark.parametrize(
    ("name", "picture", "label", "pixels", "road", "void", "layout"),
    [
        ("camvid", "train/0001TP_1", "trainannot/0001TP_1", range(12), [3], [11],
         [0, 1, 1, 2, 2, *[1] * 6, 255]),
        (*FOLDER, [0, 255, 127], [1], [2], None),
        (*FOLDER, [0, 255, 128], [1], [2], None),
        (*FOLDER, [0, 1, 128], [1], [2], None),
        ("idd-lite", "images/a", "labels/a", [*range(7), 255], [0], [7],
         [2, 2, 1, 1, 1, 1, 0, 255]),
        ("cityscapes", f"leftImg8bit/{ULM}_leftImg8bit", f"gtFine/{ULM}_gtFine_labelIds",
         [*range(34), 255], [7], [n for n in range(35) if n not in SCORED], CITY_LAYOUT),
        ("kitti-road", "image_2/um_000000", "gt_image_2/um_road_000000",
         [(255, 0, 255), (255, 0, 0), (0, 0, 0), (0, 0, 255)], [0], [2, 3], None),
    ],
)  # fmt: skip
def test_what_the_labels_of_a_set_mean(tmp_path, name, picture, label, pixels, road, void, layout):
    write_png(tmp_path / f"{picture}.png", np.zeros((1, len(pixels), 3), np.uint8))
    write_png(tmp_path / f"{label}.png", np.array([pixels], np.uint8))
    for part in ("val", "valannot") if name == "camvid" else ():
        (tmp_path / part).symlink_to(tmp_path / part.replace("val", "train"))
    found = open_dataset(name, tmp_path)

    truth = found.read(found.items[0])[1]

    assert truth.road[0].nonzero().flatten().tolist() == road
    assert (~truth.valid[0]).nonzero().flatten().tolist() == void
    assert (truth.layout if truth.layout is None else truth.layout[0].tolist()) == layout


# --- folder --------------------------------------------------------------------------------------


def grouped_set(root: Path) -> Dataset:
    """Two cameras: one with masks, one with road, void and the layout of one of its pictures."""
    picture = np.zeros((1, 3, 3), np.uint8)
    for name in ("near/images/a", "far/images/a", "far/images/b"):
        write_png(root / f"{name}.png", picture)
    write_png(root / "near/masks/a.png", np.array([[0, 255, 127]], np.uint8))
    for name in ("a", "b"):
        write_png(root / f"far/road/{name}.png", np.array([[0, 1, 255]], np.uint8))
    write_png(root / "far/layout/a.png", np.array([[0, 2, 255]], np.uint8))
    (root / "notes").mkdir()
    return open_dataset("folder", root)


def test_folders_of_pictures_and_labels_are_the_groups(tmp_path):
    found = grouped_set(tmp_path)

    assert [(item.name, item.group) for item in found.items] == [
        ("far/a", "far"), ("far/b", "far"), ("near/a", "near")
    ]  # fmt: skip
    for item in found.items:
        truth = found.truth(item)
        assert truth.road[0].tolist() == [False, True, False], item.name
        assert truth.valid[0].tolist() == [True, True, False], item.name
    layouts = [found.truth(item).layout for item in found.items]
    assert layouts[0] is not None
    assert layouts[0][0].tolist() == [0, 2, 255]
    assert layouts[1:] == [None, None]


def test_a_folder_without_pictures_and_a_layout_of_another_size_are_named(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match=r"empty: has no folder images, nor folders that have"):
        open_dataset("folder", tmp_path / "empty")

    found = grouped_set(tmp_path / "set")
    write_png(tmp_path / "set/far/layout/a.png", np.zeros((2, 3), np.uint8))

    with pytest.raises(DatasetError, match=r"layout/a\.png: is 3 by 2 pixels, unlike a\.png"):
        found.truth(found.items[0])


def test_one_and_255_in_one_mask_are_ambiguous(tmp_path):
    write_png(tmp_path / "images/a.png", np.zeros((1, 3, 3), np.uint8))
    write_png(tmp_path / "masks/a.png", np.array([[0, 1, 255]], np.uint8))
    found = open_dataset("folder", tmp_path)

    with pytest.raises(DatasetError, match="both 1 and 255"):
        found.truth(found.items[0])


# --- IDD Lite ------------------------------------------------------------------------------------


@pytest.mark.data
def test_shares_of_the_classes_of_idd_lite(data_root):
    found = open_dataset("idd-lite", data_root / "idd_lite")
    counts = np.zeros(256, np.int64)
    for item in found.items:
        counts += np.bincount(read_labels(item.label).ravel(), minlength=256)

    shares = 100 * counts[[0, 1, 6, 255]] / counts.sum()
    assert len(found.items) == 250
    assert shares.tolist() == pytest.approx([31.41, 2.36, 20.15, 0.01], abs=6e-3)


# --- Cityscapes ----------------------------------------------------------------------------------


def write_city(root: Path, name: str, split: str = "val") -> Path:
    place = f"{split}/{name.partition('_')[0]}/{name}"
    write_png(root / f"leftImg8bit/{place}_leftImg8bit.png", np.zeros((1, 1, 3), np.uint8))
    write_png(root / f"gtFine/{place}_gtFine_labelIds.png", np.zeros((1, 1), np.uint8))
    return root / f"gtFine/{place}_gtFine_labelIds.png"


def test_cityscapes_is_grouped_by_city(tmp_path):
    for name in ("ulm_000001_000019", "bonn_000000_000019"):
        write_city(tmp_path, name)
    write_city(tmp_path, "aachen_000000_000019", "train")

    found = open_dataset("cityscapes", tmp_path)

    assert [item.name for item in found.items] == ["bonn_000000_000019", "ulm_000001_000019"]
    assert found.groups() == ["bonn", "ulm"]
    assert open_dataset("cityscapes", tmp_path, "train").groups() == ["aachen"]


def test_what_cityscapes_may_lack(tmp_path):
    with pytest.raises(DatasetError, match="leftImg8bit/val: does not exist"):
        open_dataset("cityscapes", tmp_path)
    label = write_city(tmp_path, "ulm_000001_000019")
    label.unlink()
    with pytest.raises(DatasetError, match=r"_labelIds\.png: is missing, 1 of 1"):
        open_dataset("cityscapes", tmp_path)
    for picture in (tmp_path / "leftImg8bit").rglob("*.png"):
        picture.unlink()
    with pytest.raises(DatasetError, match=r"holds no pictures CITY/\*_leftImg8bit\.png"):
        open_dataset("cityscapes", tmp_path)


# --- the examples of docs/evaluation.md ----------------------------------------------------------


def documented(name: str) -> Any:
    """What the example of that name in the documentation defines."""
    blocks = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    space: dict[str, Any] = {"__name__": __name__}
    exec(next(block for block in blocks if name in block), space)
    return space[name]


def test_the_documented_set(tmp_path):
    kind = documented("MOUNTAIN_ROADS")
    for name in ("pass-1", "pass-2", "valley-1"):
        write_png(tmp_path / f"test/photos/{name}.png", np.zeros((1, 4, 3), np.uint8))
        write_png(tmp_path / f"test/labels/{name}.png", np.array([[0, 1, 2, 9]], np.uint8))

    found = kind.open(tmp_path, kind.splits[0])
    truth = found.read(found.items[0])[1]

    assert isinstance(kind, Kind)
    assert found.groups() == ["pass", "valley"]
    assert truth.road[0].tolist() == [False, True, True, False]
    assert truth.valid[0].tolist() == [True, True, True, False]


def test_the_documented_reader(tmp_path):
    write_png(tmp_path / "a.png", np.array([[0, 100, 255]], np.uint8))

    truth = documented("Probability")().truth(Item("a", tmp_path / "a.png", tmp_path / "a.png"))

    assert truth.road[0].tolist() == [False, False, True]
    assert truth.valid[0].tolist() == [True, False, True]
