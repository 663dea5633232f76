"""roadtorch grid on videos and bags: one grid per frame, one pitch per source."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest

from roadtorch.base.image import to_pixels
from tests.command import Call, bytes_in, read_index_rows
from tests.inputs.bags import FIRST, ROS2, STEP, raw_image, write_bag, write_drive
from tests.run.test_grids import TRIANGLE, VIEW
from tests.run.writers.test_bags import read_bag
from tests.streets import scene
from tests.videos import write_video

HEIGHT, WIDTH, HORIZON = 120, 160, 0.42
FOCAL = 0.95 * WIDTH  # that of the rendered streets
MAP = ("--height", 1.35, "--range", 20, "--side", 8, "--resolution", 0.2)


def street(seed: int) -> np.ndarray:
    """Return a street, uint8 (120, 160, 3); all streets have the same camera."""
    return to_pixels(scene(seed, HEIGHT, WIDTH, horizon=HORIZON, dusk=0.0).image)


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Return a bag of three streets with camera_info."""
    return write_drive(tmp_path, "mcap", [street(seed) for seed in (3, 4, 5)], FOCAL)


@pytest.mark.parametrize("form", ["bag", "mcap"])
def test_a_bag_gives_grids_and_messages(call: Call, tmp_path: Path, out: Path, form: str) -> None:
    drive = write_drive(tmp_path, form, [street(s) for s in (3, 4)], FOCAL)
    options = ("--pitch", 3, "--frame-id", "robot", *TRIANGLE)

    result = call("grid", drive, "--out", out, *MAP, *options)

    assert result.exit_code == 0, result.stderr
    messages = list(read_bag(out / ("drive.grid.bag" if form == "bag" else "drive.grid")))
    assert {entry.topic for entry in messages} == {"/segmentation/grid"}
    assert [entry.stamp for entry in messages] == [FIRST + 7, FIRST + STEP + 7]
    for number, entry in enumerate(messages):
        cells = np.load(out / "drive" / f"{number:06d}.grid.npy")
        about = entry.message.info
        assert np.array_equal(entry.message.data.reshape(about.height, about.width), cells)
        assert about.resolution == pytest.approx(0.2)
        assert (about.origin.position.x, about.origin.position.y) == (0, -8)
        assert entry.message.header.frame_id == "robot"
    assert (out / "drive" / "000001.grid.pgm").is_file()
    row = read_index_rows(out)["drive/000001"]
    assert (row["saved"], row["seconds"]) == ("pgm yaml npy bag", "0.100")


def test_a_bag_whose_clock_steps_gives_a_grid_for_each_frame(
    call: Call, tmp_path: Path, out: Path
) -> None:
    stamps = [FIRST + STEP * at for at in (9000, 0, 1)]
    drive = write_drive(tmp_path, "mcap", [street(seed) for seed in (3, 4, 5)], FOCAL, stamps)

    with warnings.catch_warnings():
        warnings.simplefilter("always")  # the command prints them
        result = call("grid", drive, "--out", out, *MAP)

    assert result.exit_code == 0, result.stderr
    headers = [entry.message.header.stamp for entry in read_bag(out / "drive.grid")]
    assert [stamp.sec * 10**9 + stamp.nanosec for stamp in headers] == stamps
    assert len(read_index_rows(out)) == 4
    assert result.stderr.count(f"warning: {drive}: the clock steps by -900.1 s at 0.0 s (") == 1


def test_the_lens_is_that_of_the_bags_camera_info(call: Call, drive: Path, tmp_path: Path) -> None:
    info = tmp_path / "info.yaml"
    matrix = [FOCAL, 0, WIDTH / 2, 0, FOCAL, HEIGHT / 2, 0, 0, 1]
    info.write_text(f"{{width: {WIDTH}, height: {HEIGHT}, k: {matrix}}}")
    options = ("grid", drive, *MAP, "--pitch", 3, "--limit", 1, *TRIANGLE, "--out")

    call(*options, tmp_path / "own")
    call(*options, tmp_path / "told", "--camera-info", info)
    call(*options, tmp_path / "other", "--fov", 90)

    recorded, from_file, wider = (
        (tmp_path / name / "drive" / "000000.grid.npy").read_bytes()
        for name in ("own", "told", "other")
    )
    assert recorded == from_file != wider


def test_all_frames_have_the_median_of_their_pitches(call: Call, drive: Path, out: Path) -> None:
    result = call("grid", drive, "--out", out, *MAP)

    assert result.exit_code == 0, result.stderr
    comments = {path.read_text().splitlines()[0] for path in out.rglob("*.grid.yaml")}
    assert len(comments) == 1
    words = comments.pop().split()
    assert "median of 3 frames" in " ".join(words)
    true = math.degrees(math.atan((HEIGHT / 2 - (HORIZON * HEIGHT - 0.5)) / FOCAL))
    assert float(words[2]) == pytest.approx(true, abs=1.5)
    low, high = float(words[8].strip("(")), float(words[10].strip(")"))
    assert low <= float(words[2]) <= high > low


def test_neither_jobs_nor_a_second_run_change_grids(call: Call, tmp_path: Path) -> None:
    video = write_video(tmp_path / "drive.mp4", size=(HEIGHT, WIDTH))
    run = ("grid", video, *VIEW, "--every", 4, "--likelihood", "--image", "--out")
    results = [call(*run, tmp_path / jobs, "--jobs", jobs) for jobs in "12"]

    assert [result.exit_code for result in results] == [0, 0], results[0].stderr
    assert bytes_in(tmp_path / "1") == bytes_in(tmp_path / "2")
    names = {f"drive/{n:06d}.grid{end}" for n in (0, 4, 8)
             for end in (".pgm", ".yaml", ".npy", ".likelihood.npy", ".jpg")}  # fmt: skip
    assert set(bytes_in(tmp_path / "1")) == names | {"config.toml"}
    again = call(*run, tmp_path / "1")
    assert "1 skipped (done before)" in again.stderr


# --- what goes wrong --------------------------------------------------------------------


def test_a_frame_of_another_shape_costs_itself_alone(call: Call, tmp_path: Path, out: Path) -> None:
    images = [street(3), street(4)[:60], street(5)]
    drive = write_drive(tmp_path, "mcap", images, FOCAL)

    result = call("grid", drive, *MAP, "--pitch", 3, *TRIANGLE, "--out", out)

    assert result.exit_code == 1
    message = f"failed: {drive}:/camera/image_raw#1: is 160×60 pixels, the calibration 160×120"
    assert message in result.stderr
    assert "2 frames, 1 failed" in result.stderr
    assert len(list(read_bag(out / "drive.grid"))) == 2


def test_a_bag_without_camera_info_needs_a_lens(call: Call, tmp_path: Path, out: Path) -> None:
    images = [raw_image(ROS2, street(3), "rgb8", FIRST)]
    drive = write_bag(tmp_path / "drive", {"/camera/image_raw": images})
    run = ("grid", drive, *MAP, "--pitch", 3, *TRIANGLE, "--out", out)

    result = call(*run)

    assert result.exit_code == 1
    assert f"failed: {drive}: has no camera_info /camera/camera_info beside" in result.stderr
    assert call(*run, "--fov", 60, "--overwrite").exit_code == 0


def test_footage_that_does_not_tell_its_pitch(call: Call, drive: Path, out: Path) -> None:
    result = call("grid", drive, *MAP, *TRIANGLE, "--out", out)

    assert result.exit_code == 1
    problem = "has no layout from this detector to estimate the pitch (give --pitch"
    assert f"failed: {drive}: {problem}" in result.stderr
