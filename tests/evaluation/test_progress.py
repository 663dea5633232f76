"""A run goes on where it was, and never on what another run counted."""

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, every_kth, leave_out
from roadtorch.evaluation.evaluate import FILE, key_of_run, read_progress, write_progress
from roadtorch.evaluation.methods import contenders, named_detector
from roadtorch.evaluation.tally import Tally
from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings
from roadtorch.layout.weights import save_network
from tests.evaluation.conftest import GROUPS
from tests.streets import write_camvid


def test_only_the_progress_of_the_same_run_is_taken_up(tmp_path: Path) -> None:
    path = tmp_path / FILE
    write_progress(path, "one", {"it": Tally(pictures=[("a", "all")])})

    assert read_progress(path, "other") == read_progress(tmp_path / "none.npz", "one") == {}
    assert read_progress(path, "one")["it"].pictures == [("a", "all")]


def test_a_file_that_is_no_progress_or_has_a_flipped_bit_holds_none(tmp_path: Path) -> None:
    path, whole = tmp_path / FILE, {"it": Tally(pictures=[("a", "all")])}
    write_progress(path, "one", whole)
    data = path.read_bytes()
    held = []
    for place in range(0, len(data), 3):
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        held.append(read_progress(path, "one"))
    path.write_bytes(b"<html>not found</html>")

    assert read_progress(path, "one") == {}
    assert all(progress in ({}, whole) for progress in held)  # a date inside tells nothing
    assert held.count({}) > len(held) / 2


Files = dict[str, Path]


@pytest.fixture
def files(scenes, tmp_path: Path) -> Files:
    """All that a run reads, by what it is."""
    write_camvid(tmp_path / "camvid", "train", scenes)
    write_camvid(tmp_path / "other", "train", scenes)
    road = np.eye(48, 64, dtype=np.uint8) * 255
    (tmp_path / "maps").mkdir()
    for name in ("maps/0001TP_0.png", "mask.png"):
        cv2.imwrite(str(tmp_path / name), road)
    network = PictureNetwork(PictureNetworkSettings(height=32, width=40, narrow=8, wide=8))
    save_network(tmp_path / "weights.safetensors", network, {})
    return {
        "picture": tmp_path / "camvid/train/0001TP_0.png",
        "label": next((tmp_path / "camvid/trainannot").glob("0001TP_0*")),
        "weights": tmp_path / "weights.safetensors",
        "map": tmp_path / "maps/0001TP_0.png",
        "mask of the ego car": tmp_path / "mask.png",
        "set of --mean-from": next((tmp_path / "other/trainannot").glob("0001TP_0*")),
    }


def key(files: Files, detector: str = "layout", **settings: Any) -> str:
    """The key of a run that reads all of them; one group alone needs another set for prior:mean."""
    root = files["picture"].parents[2]
    first = every_kth(open_dataset("camvid", root / "camvid", "train"), 1)
    values = {
        "weights": {"file": str(files["weights"])},
        "ego": {"mask": str(files["mask of the ego car"])},
        **settings,
    }
    values = values if detector == "layout" else settings
    teacher = open_dataset("camvid", root / "other", "train")
    return key_of_run(first, contenders(first, [detector], values, {"net": root / "maps"}, teacher))


@pytest.mark.parametrize(
    "name", ["picture", "label", "weights", "map", "mask of the ego car", "set of --mean-from"]
)
def test_a_file_with_other_bytes_makes_another_run(files: Files, name: str) -> None:
    before, path = key(files), files[name]
    status, data = path.stat(), path.read_bytes()

    changed = changed_pixels(path) if path.suffix == ".png" else data[:-1] + bytes([data[-1] ^ 1])
    path.write_bytes(changed)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))  # nothing but the bytes tells

    assert key(files) != before
    path.write_bytes(data)
    assert key(files) == before


def changed_pixels(path: Path) -> bytes:
    """The same picture upside down."""
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    return cv2.imencode(".png", pixels[::-1])[1].tobytes()


def test_another_question_makes_another_run(files: Files, dataset: Dataset) -> None:
    rows = [named_detector("prior:rows", {})]
    keys = {
        key(files),
        key(files, threshold=0.6),
        key(files, "prior:uniform"),
        key_of_run(dataset, rows),
        key_of_run(leave_out(dataset, GROUPS[:1]), rows),
    }

    assert len(keys) == 5
