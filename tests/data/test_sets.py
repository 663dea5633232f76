"""Labelled sets: files, splits, groups, labels, conditions, sets of other packages."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from roadtorch.base.errors import DatasetError
from roadtorch.data.camvid import CLASSES11, COLOURS32, segnet_split
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, leave_out
from roadtorch.data.label_folders import add_conditions
from tests.data.conftest import write

DOCUMENT = Path(__file__).resolve().parents[2] / "docs/evaluation.md"


# --- files ---------------------------------------------------------------------------------------

FRAMES = ("0001TP_008520", "0001TP_008550", "0016E5_07959", "0016E5_08190", "Seq05VD_f00000")
CAMVID = ("{0}/{1}", "{0}annot/{1}", ["train 0006R0_1", "val 0016E5_7959", "test Seq05VD_1"])
CAMVID32 = ("images/{0}", "labels/{0}_L", FRAMES)
KITTI = ["um 000001", "umm 000000", "uu 000000", "um 000000"]
CITIES = ("leftImg8bit/{0}_leftImg8bit", "gtFine/{0}_gtFine_labelIds",
          ["val/ulm/ulm_1_2", "val/bonn/bonn_0_2", "train/aachen/aachen_0_0"])  # fmt: skip


@pytest.mark.parametrize(
    ("name", "split", "image", "label", "files", "expected"),
    [
        ("camvid", None, *CAMVID, {"0006R0_1": "0006R0", "0016E5_7959": "0016E5"}),
        ("camvid", "val", *CAMVID, {"0016E5_7959": "0016E5"}),
        ("camvid", "test", *CAMVID, {"Seq05VD_1": "Seq05V"}),
        *(("camvid32", split, *CAMVID32, {FRAMES[i]: FRAMES[i][:6] for i in chosen})
          for split, chosen in {None: range(5), "dev": (0, 2, 3), "train": (0, 3), "val": (2,),
                                "test": (1, 4)}.items()),
        *(("camvid32", None, f"{images}/{{}}", f"{labels}/{{}}_L", FRAMES[:1],
           {FRAMES[0]: "0001TP"})
          for images, labels in {"701_StillsRaw_full": "LabeledApproved_full",
                                 "images/701_StillsRaw_full": "labels",
                                 "train": "train_labels"}.items()),
        ("kitti-road", None, "image_2/{0}_{1}", "gt_image_2/{0}_road_{1}", KITTI,
         {"um_000000": "um", "um_000001": "um", "umm_000000": "umm", "uu_000000": "uu"}),
        ("kitti-road", "lane", "training/image_2/{0}_{1}", "training/gt_image_2/{0}_lane_{1}",
         KITTI, {"um_000000": "um", "um_000001": "um"}),
        ("cityscapes", None, *CITIES, {"bonn_0_2": "bonn", "ulm_1_2": "ulm"}),
        ("cityscapes", "train", *CITIES, {"aachen_0_0": "aachen"}),
        ("folder", None, "{0}/images/{1}", "{0}/masks/{1}", ["near a", "far b", "far a"],
         {"far/a": "far", "far/b": "far", "near/a": "near"}),
    ],
)  # fmt: skip
def test_items_and_their_groups_come_from_the_names_of_files(
    tmp_path, name, split, image, label, files, expected
):
    for file in files:
        for pattern in (image, label):
            write(tmp_path / f"{pattern.format(*file.split())}.png", np.zeros((1, 1), np.uint8))

    dataset = open_dataset(name, tmp_path, split)

    assert {item.name: item.group for item in dataset.items} == expected
    assert [item.name for item in dataset.items] == [*expected]
    assert dataset.groups() == sorted({*expected.values()})


# --- labels --------------------------------------------------------------------------------------

FOLDER = ("folder", "images/a", "masks/a")
ULM = "val/ulm/ulm_000001_000019"
SCORED = [7, 8, 11, 12, 13, 17, *range(19, 29), 31, 32, 33]  # the 19 of Cityscapes' own evaluation
CITY_LAYOUT = [{7: 2, 8: 2, 22: 2, 23: 0}.get(n, 1) if n in SCORED else 255 for n in range(35)]


@pytest.mark.parametrize(
    ("name", "image", "label", "pixels", "road", "void", "layout"),
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
def test_what_the_labels_of_a_set_mean(tmp_path, name, image, label, pixels, road, void, layout):
    write(tmp_path / f"{image}.png", np.zeros((1, len(pixels), 3), np.uint8))
    write(tmp_path / f"{label}.png", np.array([pixels], np.uint8))
    for part in ("val", "valannot") if name == "camvid" else ():
        (tmp_path / part).symlink_to(tmp_path / part.replace("val", "train"))
    dataset = open_dataset(name, tmp_path)

    truth = dataset.read(dataset.items[0])[1]

    assert truth.road[0].nonzero().flatten().tolist() == road
    assert (~truth.valid[0]).nonzero().flatten().tolist() == void
    assert (truth.layout if truth.layout is None else truth.layout[0].tolist()) == layout


NAMES = [name for _, name, _ in COLOURS32]
ROAD = {"Road", "LaneMkgsDriv", "LaneMkgsNonDriv", "RoadShoulder"}
RARE = {"Archway", "Bridge", "CartLuggagePram", "Child", "OtherMoving", "TrafficCone"}
VOID = RARE | {"Void", "Animal", "Train", "Tunnel"}


def names_where(values: torch.Tensor) -> set[str]:
    return {NAMES[i] for i in values[0].nonzero().flatten().tolist()}


@pytest.mark.parametrize(
    ("name", "road", "horizontal", "vertical", "void"),
    [
        ("camvid32", ROAD, ROAD | {"Sidewalk", "ParkingBlock"}, 15, VOID),
        # by the paper's sentence
        ("camvid32:literal", {"Road"}, {"Road", "Sidewalk"}, 29, set()),
        ("camvid32:literal-ignore", {"Road"}, {"Road", "Sidewalk"}, 28, {"Void"}),
    ],
)
def test_what_the_colours_of_camvid_mean(tmp_path, name, road, horizontal, vertical, void):
    colours = np.array([colour for colour, _, _ in COLOURS32], np.uint8)[None]
    write(tmp_path / "images/0006R0_f01050.png", np.zeros_like(colours))
    write(tmp_path / "labels/0006R0_f01050_L.png", colours)
    dataset = open_dataset(name, tmp_path)

    truth = dataset.read(dataset.items[0])[1]

    assert dataset.name == name
    assert names_where(truth.road) == road
    assert truth.layout is not None
    assert names_where(truth.layout == 0) == {"Sky"}
    assert (truth.layout == 1).sum() == vertical
    assert names_where(truth.layout == 2) == horizontal
    assert names_where(~truth.valid) == names_where(truth.layout == 255) == void


@pytest.mark.data
def test_the_table_is_the_measured_one(data_root):
    with (data_root / "camvid_full/to11.csv").open() as file:
        measured = {row["name"]: CLASSES11[int(row["index11"])] for row in csv.DictReader(file)}
    with (data_root / "camvid_full/colors32.csv").open() as file:
        colours = {row["name"]: tuple(int(row[c]) for c in "rgb") for row in csv.DictReader(file)}

    assert {name: label for _, name, label in COLOURS32} == measured
    assert {name: colour for colour, name, _ in COLOURS32} == colours


@pytest.mark.data
def test_names_tell_the_splits_of_the_release(data_root):
    for split in ("train", "val"):
        items = open_dataset("camvid", data_root / "camvid", split).items
        assert {segnet_split(item.name) for item in items} == {split}


# --- folder --------------------------------------------------------------------------------------


def test_a_folder_may_have_layouts_of_some_images(tmp_path):
    for name in "ab":
        write(tmp_path / f"images/{name}.png", np.zeros((1, 3, 3), np.uint8))
        write(tmp_path / f"road/{name}.png", np.array([[0, 1, 255]], np.uint8))
    write(tmp_path / "layout/a.png", np.array([[0, 2, 255]], np.uint8))

    dataset = open_dataset("folder", tmp_path)
    first, second = map(dataset.truth, dataset.items)

    for truth in (first, second):
        assert truth.road[0].tolist() == [False, True, False]
        assert truth.valid[0].tolist() == [True, True, False]
    assert first.layout is not None
    assert (first.layout[0].tolist(), second.layout) == ([0, 2, 255], None)


def test_coco_beside_images_is_a_set_and_images_without_a_region_are_left_out(tmp_path):
    for name in "ab":
        write(tmp_path / f"images/{name}.jpg", np.zeros((1, 3, 3), np.uint8))
    images = [{"id": at, "file_name": f"{name}.jpg", "width": 3, "height": 1}
              for at, name in enumerate("ab")]  # fmt: skip
    region = {"image_id": 0, "category_id": 1, "segmentation": [[1, 0, 2, 0, 2, 1, 1, 1]]}
    document = {
        "images": images,
        "categories": [{"id": 1, "name": "lane"}],
        "annotations": [region],
    }
    write(tmp_path / "annotations/instances_default.json", json.dumps(document))

    dataset = open_dataset("folder", tmp_path, road=["lane"])

    assert [item.name for item in dataset.items] == ["a"]
    assert dataset.truth(dataset.items[0]).road[0].tolist() == [False, True, False]
    assert "1 of 2 images have a mask, none for b.jpg; road is lane (33.3 %)" in dataset.summary


# --- conditions of folders -----------------------------------------------------------------------

TABLE = """name,file,place,condition,size
near,a.png,"a town, by the sea",day bonnet,3x1
far,a.png,,night,3x1
far,b.png,,night rain night,3x1
"""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write two cameras; ``a`` is an image of both."""
    folder = tmp_path_factory.mktemp("set")
    (folder / "notes").mkdir()  # no group
    for name in ("near/{}/a", "far/{}/a", "far/{}/b", "far/{}/c"):
        for part in ("images", "masks"):
            write(folder / f"{name.format(part)}.png", np.zeros((1, 3), np.uint8))
    (folder / "pictures.csv").write_text(TABLE)
    return folder


def conditions(dataset: Dataset) -> dict[str, list[str]]:
    return {
        name: [item.name for item in items] for name, items in dataset.items_by_condition().items()
    }


def test_a_table_in_the_folder_is_read_and_every_word_is_a_condition(root):
    dataset = open_dataset("folder", root)

    assert conditions(dataset) == {
        "bonnet": ["near/a"], "day": ["near/a"], "night": ["far/a", "far/b"], "rain": ["far/b"]
    }  # fmt: skip
    assert {item.name: item.conditions for item in dataset.items}["far/c"] == ()
    assert conditions(open_dataset("folder", root / "far")) == {}


@pytest.mark.parametrize(
    ("folder", "text", "expected"),
    [
        (".", "\N{ZERO WIDTH NO-BREAK SPACE}condition,name,file\nfog,far,c.png\n",
         {"fog": ["far/c"]}),
        ("far", "file,condition\nb.png,dusk\n", {"dusk": ["b"]}),  # a set without groups
    ],
)  # fmt: skip
def test_another_table_takes_its_place(root, tmp_path, folder, text, expected):
    table = tmp_path / "other.csv"
    table.write_text(text)
    dataset = open_dataset("folder", root / folder)

    assert conditions(add_conditions(dataset, table)) == expected
    with pytest.raises(DatasetError, match=r"none\.csv: cannot be read: .*No such file"):
        add_conditions(dataset, tmp_path / "none.csv")


def test_groups_left_out_stay_in_the_set_but_in_no_condition(root):
    whole = open_dataset("folder", root)

    dataset = leave_out(whole, ["far"])

    assert dataset.items == whole.items
    assert dataset.groups() == ["far", "near"]
    assert dataset.left_out == {"far"}
    assert set(dataset.items_by_condition()) == {"day", "bonnet"}
    assert leave_out(whole, ()) == whole


# --- the examples of docs/evaluation.md ----------------------------------------------------------


def test_the_documented_set(tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    space: dict[str, Any] = {"__name__": __name__}
    exec(next(block for block in blocks if "open_mountain_roads" in block), space)
    for name in ("pass-1", "pass-2", "valley-1"):
        write(tmp_path / f"test/photos/{name}.png", np.zeros((1, 4, 3), np.uint8))
        write(tmp_path / f"test/labels/{name}.png", np.array([[0, 1, 2, 9]], np.uint8))

    dataset = space["open_mountain_roads"](tmp_path, "test")
    truth = dataset.read(dataset.items[0])[1]

    assert dataset.groups() == ["pass", "valley"]
    assert truth.road[0].tolist() == [False, True, True, False]
    assert truth.valid[0].tolist() == [True, True, True, False]
