"""CamVid in eleven classes and in 32 colours, with each mapping of the colours."""

import csv
from pathlib import Path

import numpy as np
import pytest
import torch

from roadtorch.base.errors import DatasetError
from roadtorch.data.camvid import CLASSES11, COLOURS32, segnet_split
from roadtorch.data.catalogue import open_dataset
from tests.data.conftest import write
from tests.streets import scene, write_camvid, write_drives

NAMES = [name for _, name, _ in COLOURS32]


def write_frame(root: Path, name: str, images: str = "images", labels: str = "labels") -> None:
    """Write an image of 32 by 1 pixels that has every colour once, in the table's order."""
    colours = np.array([colour for colour, _, _ in COLOURS32], np.uint8)[None]
    write(root / images / f"{name}.png", np.zeros_like(colours))
    write(root / labels / f"{name}_L.png", colours)


def names_where(values: torch.Tensor) -> set[str]:
    return {NAMES[i] for i in values[0].nonzero().flatten().tolist()}


# --- eleven classes --------------------------------------------------------------------------


@pytest.fixture
def camvid(tmp_path):
    write_drives(tmp_path)
    return tmp_path / "camvid"


def test_camvid_dev_is_train_and_val_by_drive(camvid):
    dataset = open_dataset("camvid", camvid)

    assert dataset.split == "dev"
    assert [item.name for item in dataset.items] == ["0001TP_0", "0006R0_1", "0016E5_7959"]
    assert dataset.groups() == ["0001TP", "0006R0", "0016E5"]
    assert len(open_dataset("camvid", camvid, "val").items) == 1


def test_camvid_test_is_read_where_it_is_and_is_no_part_of_dev(camvid):
    with pytest.raises(DatasetError, match="test"):
        open_dataset("camvid", camvid, "test")
    write_camvid(camvid, "test", {"Seq05VD_1": scene(3, 24, 32)})

    dataset = open_dataset("camvid", camvid, "test")

    assert [(item.name, item.group) for item in dataset.items] == [("Seq05VD_1", "Seq05V")]
    assert "Seq05V" not in open_dataset("camvid", camvid).groups()


# --- 32 colours ------------------------------------------------------------------------------


ROAD = {"Road", "LaneMkgsDriv", "LaneMkgsNonDriv", "RoadShoulder"}
RARE = {"Archway", "Bridge", "CartLuggagePram", "Child", "OtherMoving", "TrafficCone"}
VOID = RARE | {"Void", "Animal", "Train", "Tunnel"}


@pytest.mark.parametrize(
    ("name", "road", "horizontal", "vertical", "void"),
    [
        ("camvid32", ROAD, ROAD | {"Sidewalk", "ParkingBlock"}, 15, VOID),
        # by the paper's sentence
        ("camvid32:literal", {"Road"}, {"Road", "Sidewalk"}, 29, set()),
        ("camvid32:literal-ignore", {"Road"}, {"Road", "Sidewalk"}, 28, {"Void"}),
    ],
)
def test_what_the_colours_are_read_as(tmp_path, name, road, horizontal, vertical, void):
    write_frame(tmp_path, "0006R0_f01050")
    dataset = open_dataset(name, tmp_path)

    truth = dataset.read(dataset.items[0])[1]

    assert (dataset.name, dataset.groups()) == (name, ["0006R0"])
    assert names_where(truth.road) == road
    assert truth.layout is not None
    assert names_where(truth.layout == 0) == {"Sky"}
    assert (truth.layout == 1).sum() == vertical
    assert names_where(truth.layout == 2) == horizontal
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
    write_frame(tmp_path, "0016E5_00390", images, labels)

    assert [item.name for item in open_dataset("camvid32", tmp_path).items] == ["0016E5_00390"]


def test_splits_go_by_the_frames_names(tmp_path):
    frames = ("0001TP_008520", "0001TP_008550", "0016E5_07959", "0016E5_08190", "Seq05VD_f00000")
    for name in frames:
        write_frame(tmp_path, name)

    splits = {
        split: [frames.index(item.name) for item in open_dataset("camvid32", tmp_path, split).items]
        for split in ("all", "dev", "train", "val", "test")
    }

    assert splits == {
        "all": [0, 1, 2, 3, 4],
        "dev": [0, 2, 3],
        "train": [0, 3],
        "val": [2],
        "test": [1, 4],
    }


# --- the real thing --------------------------------------------------------------------------


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
