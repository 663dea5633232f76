"""roadtorch infer on videos and streams: real files in, real files out."""

import hashlib
import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roadtorch.base.errors import ExitCode, InputError
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item, Selection
from roadtorch.inputs.video import video_source
from roadtorch.run.ledger import IndexRow, Ledger
from roadtorch.run.writers.video import VideoWriter
from tests.command import GREY, ROWS, Call, bytes_in, files_in, read_index_rows
from tests.inputs.bags import FIRST, STEP, write_drive
from tests.run.writers.test_bags import read_bag
from tests.videos import (
    read_frame_pixels,
    read_frame_times,
    street_pixels,
    write_tracks,
    write_video,
)


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Return a video of twelve frames in 1.2 seconds."""
    (tmp_path / "in").mkdir()
    return write_video(tmp_path / "in" / "drive.mp4")


@pytest.fixture
def run(call: Call, drive: Path, out: Path) -> Call:
    """Return ``infer`` on the video with the fastest detector, into ``out``."""
    return partial(call, "infer", drive, *ROWS, "--out", out)


def test_a_video_gives_an_overlay_and_a_row_a_frame(run: Call, drive: Path, out: Path) -> None:
    result = run()

    assert result.exit_code == 0, result.stderr
    assert result.stderr == (
        f"roadtorch: drive.mp4: 12 frames\nroadtorch: 1 done; results in {out}\n"
    )
    assert files_in(out) == {"config.toml", "drive.overlay.mp4", "index.csv", "run.json"}
    assert read_frame_times(out / "drive.overlay.mp4") == pytest.approx([n / 10 for n in range(12)])
    rows = read_index_rows(out)
    assert list(rows) == ["drive.mp4", *(f"drive/{n:06d}" for n in range(12))]
    assert [row["seconds"] for row in rows.values()][1:4] == ["0.000", "0.100", "0.200"]
    assert {row["status"] for row in rows.values()} == {"done"}
    assert rows["drive.mp4"]["sha256"] == hashlib.sha256(drive.read_bytes()).hexdigest()
    assert rows["drive/000003"]["saved"] == rows["drive.mp4"]["saved"] == "overlay"


def test_frames_are_what_the_library_says(call: Call, drive: Path, out: Path) -> None:
    kinds = "likelihood,mask,mask-video,likelihood-video,overlay-frames"

    call("infer", drive, *GREY, "--out", out, "--save", kinds, "--every", "5", "--start", "0.2",
         "--no-smoothing")  # fmt: skip

    kinds = ("likelihood.png", "mask.png", "overlay.jpg")
    names = {f"drive/{number:06d}.{kind}" for number in (2, 7) for kind in kinds}
    videos = {"drive.mask.mp4", "drive.likelihood.mp4"}
    assert files_in(out) == names | videos | {"config.toml", "index.csv", "run.json"}
    frame = next(f for f in video_source(drive, "d", Selection()).items() if f.number == 7)
    detection = load_detector("grey-uniformity").detect(frame.read())
    mask = np.asarray(Image.open(out / "drive" / "000007.mask.png"))
    assert np.array_equal(mask > 0, detection.mask.numpy())
    pixels = read_frame_pixels(out / "drive.mask.mp4")[1][..., 0] > 127
    assert (pixels == detection.mask.numpy()).mean() > 0.95
    assert video_source(drive, "d", Selection(every=5)).rate == 2


def test_neither_the_number_of_jobs_nor_the_source_changes_a_byte(
    call: Call, drive: Path, footage: Path, tmp_path: Path
) -> None:
    bag = write_drive(tmp_path, "bag", [street_pixels(n) for n in range(4)], 60.0)
    bag = bag.rename(tmp_path / "ride.bag")
    kinds = "overlay,mask,likelihood,bag,cues,grid,grid-likelihood,grid-image"
    camera = [f"--set=grid.{value}" for value in ("height=1.35", "range=20", "fov=55", "pitch=3")]
    words = ("infer", drive, bag, footage, *GREY, "--save", kinds, *camera, "--out")

    for jobs in ("1", "3"):
        result = call(*words, tmp_path / jobs, "--jobs", jobs)
        assert result.exit_code == 0, result.stderr
    again = call(*words, tmp_path / "1")
    assert again.stderr.count("roadtorch: 0 done") == 2, again.stderr

    alone, side_by_side = bytes_in(tmp_path / "1"), bytes_in(tmp_path / "3")
    differing = [name for name in alone if alone[name] != side_by_side.get(name)]
    assert alone.keys() == side_by_side.keys()
    assert all(".road/" in name or name.endswith(".road.bag") for name in differing), differing
    for name in ("drive.overlay.mp4", "b.cue.uniformity.png", "drive/000003.grid.npy"):
        assert name in alone
    lasting = [
        {name: row | {"ms": ""} for name, row in read_index_rows(tmp_path / jobs).items()}
        for jobs in "13"
    ]
    assert lasting[0] == lasting[1]


def test_a_video_is_done_with_its_options_and_its_frames_alone(
    run: Call, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, add = list[IndexRow](), Ledger.add
    run("--save", "mask,polygons", "--limit", 3)
    monkeypatch.setattr(Ledger, "add", lambda *words: (rows.append(words[1]), add(*words)))

    again = run("--save", "mask,polygons", "--limit", 2)

    assert again.stderr.endswith(f"1 done; results in {out}\n")
    assert (rows[0].file, rows[0].failed) == ("drive.mp4", True)  # what a killed run would leave
    coco = json.loads((out / "coco.json").read_text())
    assert [entry["file_name"] for entry in coco["images"]] == ["drive/000000", "drive/000001"]
    shutil.rmtree(out / "drive")
    assert "(done before)" not in run("--save", "mask,polygons", "--limit", 2).stderr


# --- bags -------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["bag", "mcap"])
def test_a_done_bag_is_skipped_until_it_or_its_results_change(
    call: Call, tmp_path: Path, out: Path, form: str
) -> None:
    drive = write_drive(tmp_path, form, [street_pixels(n) for n in range(4)], 60.0)
    road = out / ("drive.road.bag" if form == "bag" else "drive.road")
    run = partial(call, "infer", drive, *ROWS, "--out", out)
    assert run().exit_code == 0
    assert read_index_rows(out)["drive/000002"]["saved"] == "overlay bag"
    assert "1 skipped (done before)" in run().stderr

    with (drive / "note.txt" if drive.is_dir() else drive).open("ab") as file:
        file.write(b" ")
    assert "(done before)" not in run().stderr
    shutil.rmtree(road, ignore_errors=True)
    road.unlink(missing_ok=True)
    assert "(done before)" not in run().stderr
    assert "(done before)" not in run("--save", "bag", "--every", "2").stderr

    messages = list(read_bag(road))
    names = ("mask", "confidence", "overlay", "label_info")
    assert {entry.topic for entry in messages} == {f"/segmentation/{name}" for name in names}
    masks = [entry for entry in messages if entry.topic.endswith("/mask")]
    assert [entry.stamp for entry in masks] == [FIRST + 7, FIRST + 2 * STEP + 7]
    assert {entry.message.header.frame_id for entry in masks} == {"camera_optical"}
    left = {path.name.partition(".")[0] for path in out.iterdir()}
    assert left == {"", "config", "drive", "index", "run"}
    assert len(read_index_rows(out)) == 3  # frames of earlier runs are gone


def test_a_video_gives_a_bag_with_its_seconds(run: Call, out: Path) -> None:
    Image.new("RGB", (32, 32)).save(photo := out.parent / "photo.png")  # images give no bag

    assert run(photo, "--save", "bag", "--limit", 3).exit_code == 0

    assert "photo.png" not in read_index_rows(out)
    messages = [entry for entry in read_bag(out / "drive.road") if entry.topic.endswith("/mask")]
    assert [entry.stamp for entry in messages] == pytest.approx([0, 1e8, 2e8], abs=1)
    assert messages[-1].message.header.frame_id == "camera"


# --- what goes wrong --------------------------------------------------------------------


def test_a_cut_video_keeps_what_is_readable(
    call: Call, drive: Path, tmp_path: Path, out: Path
) -> None:
    cut = write_video(tmp_path / "in" / "a.mp4", [n / 10 for n in range(40)], options={"crf": "1"})
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size * 6 // 10])
    write_tracks(tmp_path / "in" / "song.mp4", sound=1.0)

    result = call("infer", tmp_path / "in", *ROWS, "--out", out)

    assert result.exit_code == 1
    first, second = (
        line
        for line in result.stderr.splitlines()
        if line.startswith(("roadtorch: failed: ", "roadtorch: partial: "))
    )
    frames = len(read_frame_times(out / "a.overlay.mp4"))
    assert 10 < frames < 40
    assert first.startswith(f"roadtorch: partial: {cut}: ends after ")
    assert " of 4.0 seconds (the rest was used; copy it again" in first
    assert "song.mp4: has audio but no video" in second
    rows = read_index_rows(out)
    assert sum(name.startswith("a/") for name in rows) == frames
    assert rows["a.mp4"]["status"] == first.removeprefix("roadtorch: ")
    assert rows["drive.mp4"]["status"] == "done"
    again = call("infer", tmp_path / "in", *ROWS, "--out", out)
    assert "a.mp4" in again.stderr  # it is redone
    assert "1 skipped (done before)" in again.stderr


@pytest.mark.parametrize(
    ("number", "error", "status"),
    [
        (5, InputError("x.mp4", "cannot be written", "make room"), "partial: {1} (make room)"),
        (0, ValueError("a surprise"), "failed: {0}: ValueError: a surprise (report it)"),
    ],
)
def test_an_error_of_a_writer_costs_the_rest_of_its_video(
    number: int,
    error: Exception,
    status: str,
    call: Call,
    drive: Path,
    out: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    other, write = write_video(drive.with_name("other.mp4")), VideoWriter.write

    def fail(self: VideoWriter, item: Item, detection: Detection) -> Mapping[str, str]:
        if self.path.name == "drive.overlay.mp4" and item.number == number:
            raise error
        return write(self, item, detection)

    monkeypatch.setattr(VideoWriter, "write", fail)

    result = call("infer", drive, other, *ROWS, "--out", out)

    rows, status = read_index_rows(out), status.format(drive, "x.mp4: cannot be written")
    assert result.exit_code == 1
    assert rows["drive.mp4"]["status"] == status
    assert f"roadtorch: {status}\n" in result.stderr
    assert sum(name.startswith("drive/") for name in rows) == number
    assert not number or len(read_frame_times(out / "drive.overlay.mp4")) == number
    assert rows["other.mp4"]["status"] == "done"


def test_ctrl_c_finishes_the_video(tmp_path: Path, out: Path) -> None:
    path = write_video(tmp_path / "drive.mp4", [n / 10 for n in range(600)])
    command = [sys.executable, "-m", "roadtorch", "infer", str(path), *ROWS, "--out", str(out)]
    command += ["--jobs", "2"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    while not (out / "index.csv").exists() or (out / "index.csv").stat().st_size < 3000:
        assert process.poll() is None
        time.sleep(0.02)

    process.send_signal(signal.SIGINT)
    message = process.communicate(timeout=600)[1]

    assert process.returncode == ExitCode.INTERRUPTED
    assert message.endswith("roadtorch: interrupted; finished results are kept\n")
    frames = len(read_frame_times(out / "drive.overlay.mp4"))
    rows = read_index_rows(out)
    assert len(rows) == frames + 1 > 20
    assert rows["drive.mp4"]["status"] == f"partial: {path}: was interrupted (run it again)"
    assert not list(out.glob(".*.part"))
