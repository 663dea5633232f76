"""roadtorch infer on bags: the bags it writes, read by rosbags."""

import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from roadtorch.detectors.catalogue import load_detector
from roadtorch.inputs.bags import bag_source
from tests.command import GREY, ROWS, Call, read_index_rows
from tests.inputs.bags import FIRST, STEP, write_drive
from tests.run.writers.test_bags import read_bag
from tests.videos import street_pixels, write_video

TOPICS = {f"/segmentation/{name}" for name in ("mask", "confidence", "overlay", "label_info")}


@pytest.fixture(params=["bag", "mcap"])
def drive(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a bag of four streets."""
    return write_drive(tmp_path, request.param, [street_pixels(n) for n in range(4)], 60.0)


@pytest.fixture
def run(call: Call, drive: Path, out: Path) -> Call:
    """Return ``infer`` on the bag with the fastest detector, into ``out``."""
    return partial(call, "infer", drive, *ROWS, "--out", out)


def road_bag(drive: Path, out: Path) -> Path:
    return out / ("drive.road.bag" if drive.suffix else "drive.road")


def test_a_bag_gives_a_bag_and_an_overlay_video(call: Call, drive: Path, out: Path) -> None:
    result = call("infer", drive, *GREY, "--set", "threshold=0.4", "--out", out, "--no-smoothing")

    assert result.exit_code == 0, result.stderr
    messages = list(read_bag(road_bag(drive, out)))
    assert {entry.topic for entry in messages} == TOPICS
    masks = [entry for entry in messages if entry.topic == "/segmentation/mask"]
    assert [entry.stamp for entry in masks] == [FIRST + STEP * number + 7 for number in range(4)]
    assert {entry.message.header.frame_id for entry in masks} == {"camera_optical"}
    detector = load_detector("grey-uniformity", threshold=0.4)
    for frame, entry in zip(bag_source(str(drive)).items(), masks, strict=True):
        mask = detector.detect(frame.read()).mask.numpy()
        assert np.array_equal(entry.message.data.reshape(mask.shape), mask)
    labels = next(entry.message for entry in messages if entry.topic == "/segmentation/label_info")
    assert labels.threshold == pytest.approx(0.4)
    assert (out / "drive.overlay.mp4").is_file()
    assert read_index_rows(out)["drive/000002"]["saved"] == "overlay bag"


def test_what_is_done_is_skipped_until_the_bag_changes(run: Call, drive: Path, out: Path) -> None:
    run()

    again = run()
    touched = drive / "note.txt" if drive.is_dir() else drive
    with touched.open("ab") as file:
        file.write(b" ")
    anew = run()

    assert "1 skipped (done before)" in again.stderr
    assert "(done before)" not in anew.stderr
    shutil.rmtree(road_bag(drive, out), ignore_errors=True)
    road_bag(drive, out).unlink(missing_ok=True)
    assert "(done before)" not in run().stderr
    assert "(done before)" not in run("--save", "bag", "--every", "2").stderr
    messages = read_bag(road_bag(drive, out))
    stamps = [entry.stamp for entry in messages if entry.topic.endswith("/mask")]
    assert stamps == [FIRST + 7, FIRST + 2 * STEP + 7]
    assert {path.name.partition(".")[0] for path in out.iterdir()} == {
        *("", "config", "drive", "index", "run")
    }


def test_a_video_gives_a_bag_with_its_seconds(call: Call, tmp_path: Path, out: Path) -> None:
    video = write_video(tmp_path / "drive.mp4")

    result = call("infer", video, *ROWS, "--out", out, "--save", "bag", "--limit", 3)

    assert result.exit_code == 0, result.stderr
    messages = [entry for entry in read_bag(out / "drive.road") if entry.topic in TOPICS]
    stamps = [entry.stamp for entry in messages if entry.topic == "/segmentation/mask"]
    assert stamps == pytest.approx([0, 1e8, 2e8], abs=1)
    assert messages[-1].message.header.frame_id == "camera"
