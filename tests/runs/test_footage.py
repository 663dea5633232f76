"""roadtorch infer on videos and streams: real files in, real files out."""

import hashlib
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import ExitCode
from roadtorch.runs.footage import FrameCount
from roadtorch.runs.index import Row
from roadtorch.sources.frame import Selection
from roadtorch.sources.video import video_source
from tests.command import ROWS, Call, bytes_in, files_in, rows_of, save_picture
from tests.sinks.test_video import fill_the_disk
from tests.videos import pixels_of, stamps_of, write_sound, write_video

GREY = ("--detector", "grey-uniformity")


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A video of twelve frames in 1.2 seconds."""
    (tmp_path / "in").mkdir()
    return write_video(tmp_path / "in" / "drive.mp4")


@pytest.fixture
def run(call: Call, drive: Path, out: Path) -> Call:
    """``infer`` on it with the quickest detector, into ``out``."""
    return partial(call, "infer", drive, *ROWS, "--out", out)


def test_a_video_gives_an_overlay_video_and_a_row_a_frame(
    run: Call, drive: Path, out: Path
) -> None:
    result = run()

    assert result.exit_code == 0, result.stderr
    assert result.stderr == (
        f"roadtorch: drive.mp4: 12 frames\nroadtorch: 1 done; results in {out}\n"
    )
    assert files_in(out) == {"config.toml", "drive.overlay.mp4", "index.csv", "run.json"}
    assert stamps_of(out / "drive.overlay.mp4") == pytest.approx([n / 10 for n in range(12)])
    rows = rows_of(out)
    assert list(rows) == [*(f"drive/{n:06d}" for n in range(12)), "drive.mp4"]
    assert [row["seconds"] for row in rows.values()][:3] == ["0.000", "0.100", "0.200"]
    assert {row["status"] for row in rows.values()} == {"done"}
    assert rows["drive.mp4"]["sha256"] == hashlib.sha256(drive.read_bytes()).hexdigest()
    assert rows["drive/000003"]["saved"] == rows["drive.mp4"]["saved"] == "overlay"


def test_frames_are_what_the_library_says(call: Call, drive: Path, out: Path) -> None:
    kinds = "likelihood,mask,mask-video,likelihood-video,overlay-frames"

    call("infer", drive, *GREY, "--out", out, "--save", kinds, "--every", "5", "--start", "0.2",
         "--no-steady")  # fmt: skip

    names = {f"drive/{n:06d}{end}" for n in (2, 7) for end in
             (".likelihood.png", ".mask.png", ".overlay.jpg")}  # fmt: skip
    assert files_in(out) == names | {"config.toml", "index.csv", "run.json", "drive.mask.mp4",
                                     "drive.likelihood.mp4"}  # fmt: skip
    frame = next(f for f in video_source(drive, "d", Selection()).frames() if f.number == 7)
    detection = load_detector("grey-uniformity").detect(frame.read())
    mask = np.asarray(Image.open(out / "drive" / "000007.mask.png"))
    assert np.array_equal(mask > 0, detection.mask.numpy())
    shown = pixels_of(out / "drive.mask.mp4")[1][..., 0] > 127
    assert (shown == detection.mask.numpy()).mean() > 0.95


def test_a_stretch_becomes_a_gif(run: Call, out: Path) -> None:
    run("--gif", "0.2:0.7")

    with Image.open(out / "drive.overlay.gif") as gif:
        assert gif.n_frames == 5  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("given", ["3", "5:3", "0:900", "a:b"])
def test_no_stretch_is_wrong_usage(given: str, run: Call) -> None:
    result = run("--gif", given)

    assert result.exit_code == 2
    assert result.stderr.startswith("roadtorch: error: --gif: ")


def test_several_jobs_give_the_same_bytes(call: Call, drive: Path, tmp_path: Path) -> None:
    for jobs in ("1", "3"):
        call("infer", drive, *GREY, "--out", tmp_path / jobs, "--jobs", jobs,
             "--save", "overlay,mask,likelihood", "--gif", "0:1")  # fmt: skip

    assert bytes_in(tmp_path / "1") == bytes_in(tmp_path / "3")


def test_folders_of_both_and_names_on_standard_input(call: Call, tmp_path: Path, out: Path) -> None:
    root = tmp_path / "in"
    save_picture(root / "a.png")
    write_video(root / "drive.mp4")
    listed = tmp_path / "list.txt"
    listed.write_text(f"{root}\n")

    result = call("infer", f"@{listed}", *ROWS, "--out", out)

    assert result.exit_code == 0
    assert list(rows_of(out))[-1] == "drive.mp4"
    assert {"a.mask.png", "drive.overlay.mp4"} <= files_in(out)


def test_pictures_can_be_chosen_but_have_no_time(call: Call, footage: Path, out: Path) -> None:
    call("infer", footage, *ROWS, "--out", out, "--every", "2")
    refused = call("infer", footage, *ROWS, "--out", out, "--start", "2")

    assert list(rows_of(out)) == ["a.jpg", "sub/c.png"]
    assert refused.exit_code == 2
    assert "pictures have no time" in refused.stderr


# --- a second run -----------------------------------------------------------------------


def test_a_video_that_is_done_is_skipped_until_something_changes(
    run: Call, drive: Path, out: Path
) -> None:
    run()

    again = run()
    other = run("--every", "4")

    assert again.stderr == f"roadtorch: 0 done, 1 skipped (done before); results in {out}\n"
    assert other.stderr.startswith("roadtorch: drive.mp4: 3 frames")
    assert len(rows_of(out)) == 4  # those of the first run are gone
    (out / "drive.overlay.mp4").unlink()
    assert "3 frames" in run("--every", "4").stderr


def test_the_frames_of_the_least_trust_are_known_without_keeping_all() -> None:
    count = FrameCount()
    for number, trust in enumerate(["0.9", "", "0.2", "0.7", "0.8", "0.6", "0.5", "0.95"]):
        count.add(Row(f"drive/{number}", ms="1", trust=trust))

    assert [row.trust for row in count.least] == ["0.2", "0.5", "0.6", "0.7", "0.8"]


def test_an_index_cut_short_is_mended(run: Call, out: Path) -> None:
    run()
    index = out / "index.csv"
    index.write_bytes(index.read_bytes()[:-30])

    assert "12 frames" in run().stderr
    assert len(rows_of(out)) == 13


# --- what goes wrong --------------------------------------------------------------------


def test_a_cut_video_keeps_what_is_readable_and_the_others_go_on(
    call: Call, drive: Path, tmp_path: Path, out: Path
) -> None:
    whole = write_video(
        tmp_path / "in" / "a.mp4", [n / 10 for n in range(40)], options={"crf": "1"}
    )
    whole.write_bytes(whole.read_bytes()[: whole.stat().st_size * 6 // 10])
    write_sound(tmp_path / "in" / "song.mp4")

    result = call("infer", tmp_path / "in", *ROWS, "--out", out)

    assert result.exit_code == 1
    lines = [
        line for line in result.stderr.splitlines() if ": failed: " in line or ": partial: " in line
    ]
    assert len(lines) == 2
    assert f"{whole}: 21 of 40 frames, ends early, after " in lines[0]
    assert "song.mp4: has sound and no moving pictures" in lines[1]
    frames = len(stamps_of(out / "a.overlay.mp4"))
    assert 10 < frames < 40
    rows = rows_of(out)
    assert sum(name.startswith("a/") for name in rows) == frames
    assert rows["a.mp4"]["status"].startswith("partial: ")
    assert rows["drive.mp4"]["status"] == "done"
    assert "a.mp4" in call("infer", tmp_path / "in", *ROWS, "--out", out).stderr  # it is redone


def test_a_full_disk_keeps_the_finished_frames(
    call: Call, drive: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill_the_disk(monkeypatch, 8_000)
    noisy = write_video(
        drive, [n / 10 for n in range(200)], options={"crf": "1"},
        change=lambda n, pixels: np.random.default_rng(n).integers(0, 255, pixels.shape, np.uint8),
    )  # fmt: skip

    result = call("infer", noisy, *ROWS, "--out", out)

    assert result.exit_code == 1
    assert "drive.overlay.mp4: ends here: No space left on device (make room" in result.stderr
    assert result.stderr.count("partial: ") == 1
    assert 0 < len(stamps_of(out / "drive.overlay.mp4")) < 200
    assert rows_of(out)["drive.mp4"]["status"].startswith("partial: ")


def test_ctrl_c_finishes_the_video(tmp_path: Path, out: Path) -> None:
    path = write_video(tmp_path / "drive.mp4", [n / 10 for n in range(600)])
    command = [sys.executable, "-m", "roadtorch", "infer", str(path), *ROWS, "--out", str(out)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    while not (out / "index.csv").exists() or (out / "index.csv").stat().st_size < 3000:
        assert process.poll() is None
        time.sleep(0.02)

    process.send_signal(signal.SIGINT)
    told = process.communicate(timeout=60)[1]

    assert process.returncode == ExitCode.INTERRUPTED
    assert told.endswith("roadtorch: interrupted; what was finished is kept\n")
    frames = len(stamps_of(out / "drive.overlay.mp4"))
    rows = rows_of(out)
    assert len(rows) == frames + 1 > 20
    assert rows["drive.mp4"]["status"] == f"partial: {path}: was interrupted (run it again)"
    assert not list(out.glob(".*"))


def test_frames_of_another_camera_fail_one_by_one(
    call: Call, drive: Path, tmp_path: Path, out: Path
) -> None:
    from roadtorch.camera.camera import Camera

    Camera(width=200, height=50, frames=10, horizon=0.4, seed_row=1.0).write(tmp_path / "c.toml")

    result = call("infer", drive, *ROWS, "--camera", tmp_path / "c.toml", "--out", out)

    assert result.exit_code == 1
    assert f"failed: {drive}: frame 0: " in result.stderr
    assert not (out / "drive.overlay.mp4").exists()


def test_footage_is_steadied_unless_one_asks_for_its_frames_alone(
    call: Call, drive: Path, tmp_path: Path
) -> None:
    steadied, alone = tmp_path / "steadied", tmp_path / "alone"

    call("infer", drive, *GREY, "--out", steadied, "--save", "likelihood")
    call("infer", drive, *GREY, "--out", alone, "--save", "likelihood", "--no-steady")

    def frame(out: Path, number: int) -> bytes:
        return (out / f"drive/{number:06d}.likelihood.png").read_bytes()

    assert frame(steadied, 0) == frame(alone, 0)
    assert frame(steadied, 5) != frame(alone, 5)
