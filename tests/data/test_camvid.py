"""CamVid in eleven classes and in 32 colours, and how its colours are read."""

import csv
from pathlib import Path

import numpy as np
import pytest
import torch

from roadtorch.data.camvid import CLASSES11, COLOURS32, split_of
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.labels import read_labels
from roadtorch.errors import DatasetError
from roadtorch.scenes.street import render_scene
from tests.data.conftest import write_png
from tests.streets import write_camvid

NAMES = [name for _, name, _ in COLOURS32]


def write_frame(root: Path, images: str, labels: str, name: str) -> None:
    """A picture of 32 by 1 pixels that shows every colour once, in the table's order."""
    colours = np.array([colour for colour, _, _ in COLOURS32], np.uint8)[None]
    write_png(root / images / f"{name}.png", np.zeros_like(colours))
    write_png(root / labels / f"{name}_L.png", colours)


def names_where(values: torch.Tensor) -> set[str]:
    return {NAMES[i] for i in values[0].nonzero().flatten().tolist()}


# --- eleven classes --------------------------------------------------------------------------


def test_camvid_dev_is_train_and_val_by_drive(camvid):
    found = open_dataset("camvid", camvid)

    assert found.split == "dev"
    assert [item.name for item in found.items] == ["0001TP_0", "0006R0_1", "0016E5_7"]
    assert found.groups() == ["0001TP", "0006R0", "0016E5"]
    assert len(open_dataset("camvid", camvid, "val").items) == 1


def test_camvid_test_is_read_where_it_is_and_is_no_part_of_dev(camvid):
    with pytest.raises(DatasetError, match="test"):
        open_dataset("camvid", camvid, "test")
    write_camvid(camvid, "test", {"Seq05VD_1": render_scene(3, 24, 32)})

    found = open_dataset("camvid", camvid, "test")

    assert [(item.name, item.group) for item in found.items] == [("Seq05VD_1", "Seq05V")]
    assert "Seq05V" not in open_dataset("camvid", camvid).groups()


def test_camvid_truth_is_the_scenes_truth(camvid):
    found, scene = open_dataset("camvid", camvid), render_scene(0, 24, 32)

    image, truth = found.read(found.items[0])

    assert torch.allclose(image, scene.image, atol=1e-6)
    assert torch.equal(truth.road, scene.road)
    assert torch.equal(truth.valid, ~scene.void)
    assert truth.layout is not None
    assert torch.equal(truth.layout, torch.where(scene.void, 255, scene.layout))


# --- 32 colours ------------------------------------------------------------------------------


def test_the_11_class_reading(tmp_path):
    write_frame(tmp_path, "images", "labels", "0006R0_f01050")
    found = open_dataset("camvid32", tmp_path)

    truth = found.read(found.items[0])[1]

    assert found.groups() == ["0006R0"]
    road = {"Road", "LaneMkgsDriv", "LaneMkgsNonDriv", "RoadShoulder"}
    assert names_where(truth.road) == road
    assert truth.layout is not None
    assert names_where(truth.layout == 2) == road | {"Sidewalk", "ParkingBlock"}
    assert names_where(truth.layout == 0) == {"Sky"}
    rare = {"Archway", "Bridge", "CartLuggagePram", "Child", "OtherMoving", "TrafficCone"}
    void = rare | {"Void", "Animal", "Train", "Tunnel"}
    assert names_where(~truth.valid) == names_where(truth.layout == 255) == void


@pytest.mark.parametrize(
    ("name", "void", "vertical"),
    [("camvid32:literal", set(), 29), ("camvid32:literal-ignore", {"Void"}, 28)],
)
def test_the_papers_sentence_to_the_letter(tmp_path, name, void, vertical):
    write_frame(tmp_path, "images", "labels", "0006R0_f01050")
    found = open_dataset(name, tmp_path)

    truth = found.truth(found.items[0])

    assert found.name == name
    assert names_where(truth.road) == {"Road"}
    assert truth.layout is not None
    assert names_where(truth.layout == 2) == {"Road", "Sidewalk"}
    assert (truth.layout == 1).sum() == vertical
    assert names_where(~truth.valid) == names_where(truth.layout == 255) == void


@pytest.mark.parametrize(
    ("images", "labels"),
    [
        ("images", "labels"),
        ("701_StillsRaw_full", "LabeledApproved_full"),
        ("images/701_StillsRaw_full", "labels"),
        ("train", "train_labels"),
    ],
)
def test_where_copies_keep_the_files(tmp_path, images, labels):
    write_frame(tmp_path, images, labels, "0016E5_00390")

    assert [item.name for item in open_dataset("camvid32", tmp_path).items] == ["0016E5_00390"]


def test_splits_go_by_the_frames_names(tmp_path):
    frames = ("0001TP_008520", "0001TP_008550", "0016E5_07959", "0016E5_08190", "Seq05VD_f00000")
    for name in frames:
        write_frame(tmp_path, "images", "labels", name)

    found = {
        split: [frames.index(item.name) for item in open_dataset("camvid32", tmp_path, split).items]
        for split in ("all", "dev", "train", "val", "test")
    }

    assert found == {
        "all": [0, 1, 2, 3, 4],
        "dev": [0, 2, 3],
        "train": [0, 3],
        "val": [2],
        "test": [1, 4],
    }


def test_mistakes_in_the_files(tmp_path):
    with pytest.raises(DatasetError, match=r"holds no CamVid in 32 colours .*LabeledApproved_full"):
        open_dataset("camvid32", tmp_path)

    write_frame(tmp_path, "images", "labels", "0016E5_00390")
    with pytest.raises(DatasetError, match="holds no pictures of the split test"):
        open_dataset("camvid32", tmp_path, "test")

    (tmp_path / "labels/0016E5_00390_L.png").unlink()
    with pytest.raises(DatasetError, match=r"labels/0016E5_00390_L\.png: is missing, 1 of 1"):
        open_dataset("camvid32", tmp_path)

    write_frame(tmp_path, "images", "labels", "street_1")
    write_frame(tmp_path, "images", "labels", "0016E5_00390")
    with pytest.raises(DatasetError, match="street_1: is not the name of a CamVid frame"):
        open_dataset("camvid32", tmp_path)


# --- the real thing --------------------------------------------------------------------------


@pytest.mark.data
def test_the_table_is_the_measured_one(data_root):
    with (data_root / "camvid_full/to11.csv").open() as file:
        measured = {row["name"]: CLASSES11[int(row["index11"])] for row in csv.DictReader(file)}
    with (data_root / "camvid_full/colors32.csv").open() as file:
        colours = {row["name"]: tuple(int(row[c]) for c in "rgb") for row in csv.DictReader(file)}

    assert {name: became for _, name, became in COLOURS32} == measured
    assert {name: colour for colour, name, _ in COLOURS32} == colours


@pytest.mark.data
def test_names_tell_the_splits_of_the_release(data_root):
    for split in ("train", "val"):
        items = open_dataset("camvid", data_root / "camvid", split).items
        assert {split_of(item.name) for item in items} == {split}


@pytest.mark.data
def test_pixel_counts_of_the_release(data_root):
    counts = dict.fromkeys(("train", "val"), np.zeros(12, np.int64))
    for split in counts:
        for item in open_dataset("camvid", data_root / "camvid", split).items:
            counts[split] = counts[split] + np.bincount(read_labels(item.label).ravel())[:12]

    assert counts["train"].tolist() == [
        *(10682767, 14750079, 623349, 20076880, 2845085, 6166762),
        *(743859, 714595, 3719877, 405385, 184967, 2503995),
    ]
    assert counts["val"].tolist() == [
        *(1601620, 4531180, 98499, 5053176, 1521751, 2851125),
        *(155724, 537197, 304716, 113531, 387010, 297271),
    ]
