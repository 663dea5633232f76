"""roadtorch infer --save grid, from real files to real files: images, videos and bags."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from roadtorch.base.image import to_pixels
from roadtorch.camera.camera import Camera
from roadtorch.testing.scenes import render_scene, write_image
from tests.command import Call, read_index_rows
from tests.inputs.bags import FIRST, ROS2, STEP, raw_image, write_bag, write_drive
from tests.run.writers.test_bags import read_bag
from tests.run.writers.test_files import load_map
from tests.streets import scene

HEIGHT, WIDTH, HORIZON = 120, 160, 0.42
FOCAL = 0.95 * WIDTH  # that of the rendered streets
TRIANGLE = ("--detector", "prior:triangle")


def settings(**values: object) -> list[str]:
    """Return ``--set grid.KEY=VALUE`` for each."""
    return [word for key, value in values.items() for word in ("--set", f"grid.{key}={value}")]


CELLS = ("--save", "grid", *settings(height=1.35, range=20, side=8, cell=0.2))
VIEW = (*CELLS, *settings(fov=55))
PITCHED = (*CELLS, *settings(pitch=3), *TRIANGLE)


def street(seed: int) -> np.ndarray:
    """Return a street, uint8 (120, 160, 3); all streets have the same camera."""
    return to_pixels(scene(seed, HEIGHT, WIDTH, horizon=HORIZON, dusk=0.0).image)


@pytest.fixture
def streets(tmp_path: Path) -> Path:
    """Return a folder with a rendered street, and another in a subfolder."""
    for name, seed in (("a", 3), ("sub/b", 4)):
        write_image(tmp_path / "streets" / f"{name}.png", render_scene(seed, HEIGHT, WIDTH))
    return tmp_path / "streets"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Return a bag of three streets with camera_info."""
    return write_drive(tmp_path, "mcap", [street(seed) for seed in (3, 4, 5)], FOCAL)


def test_every_image_gives_a_map(call: Call, streets: Path, out: Path) -> None:
    kinds = ("--save", "grid,grid-likelihood,grid-image,mask")

    result = call("infer", streets, "--out", out, *VIEW, *kinds)

    assert result.exit_code == 0, result.stderr
    cells, values = load_map(out / "sub" / "b.grid.yaml")
    saved = np.load(out / "sub" / "b.grid.npy")
    assert cells.tolist() == saved.tolist()
    assert saved.shape == (80, 100)
    assert set(np.unique(saved)) == {0, 100, -1}
    assert values["origin"] == [0, -8, 0]
    assert "horizon at row" in (out / "a.grid.yaml").read_text()
    likelihood = np.load(out / "a.grid.likelihood.npy")
    assert (np.isnan(likelihood) == (np.load(out / "a.grid.npy") == -1)).mean() > 0.99
    assert {path.name for path in out.glob("a.*")} >= {"a.grid.jpg", "a.mask.png"}
    assert list(read_index_rows(out)) == ["a.png", "sub/b.png"]


def test_a_camera_file_has_settings_and_the_horizon_and_assignments_override_it(
    call: Call, streets: Path, tmp_path: Path
) -> None:
    path, image = tmp_path / "camera.toml", streets / "a.png"
    Camera(width=160, height=120, frames=10, horizon=0.4, seed_row=1).write(path)
    bare, all_set = path.read_text(), settings(height=1.2, fov=55)
    runs = {
        "file": ("[grid]\nheight = 1.2\nfov = 55\n", ()),
        "both": ("[grid]\nheight = 9.0\nfov = 55\n", settings(height=1.2)),
        "line": ("", all_set),
        "other": ("", [*all_set, *settings(x=0.5)]),
    }

    for name, (table, words) in runs.items():
        path.write_text(bare + table)
        rest = ("--save", "grid", *words, "--camera", path, "--out", tmp_path / name)
        assert call("infer", image, *TRIANGLE, *rest).exit_code == 0

    grids = {name: (tmp_path / name / "a.grid.npy").read_bytes() for name in runs}
    origins = {name: load_map(tmp_path / name / "a.grid.yaml")[1]["origin"][0] for name in runs}
    assert len(set(grids.values())) == 1
    assert origins == {"file": 0, "both": 0, "line": 0, "other": 0.5}
    assert "row 0.400 of the camera's file" in (tmp_path / "file" / "a.grid.yaml").read_text()


@pytest.mark.parametrize("form", ["bag", "mcap"])
def test_a_bag_gives_grids_and_messages(call: Call, tmp_path: Path, out: Path, form: str) -> None:
    drive = write_drive(tmp_path, form, [street(s) for s in (3, 4)], FOCAL)

    words = (*PITCHED, *settings(frame="robot"), "--save", "grid,bag", "--out", out)
    result = call("infer", drive, *words)

    assert result.exit_code == 0, result.stderr
    messages = list(read_bag(out / ("drive.road.bag" if form == "bag" else "drive.road")))
    images = [entry.stamp for entry in messages if entry.topic == "/segmentation/mask"]
    messages = [entry for entry in messages if entry.topic == "/segmentation/grid"]
    assert [entry.stamp for entry in messages] == [FIRST + 7, FIRST + STEP + 7] == images
    for number, entry in enumerate(messages):
        cells = np.load(out / "drive" / f"{number:06d}.grid.npy")
        about = entry.message.info
        assert np.array_equal(entry.message.data.reshape(about.height, about.width), cells)
        assert about.resolution == pytest.approx(0.2)
        place, turn = about.origin.position, about.origin.orientation
        assert (place.x, place.y, place.z) == (0, -8, 0)
        assert (turn.x, turn.y, turn.z, turn.w) == (0, 0, 0, 1)
        assert entry.message.header.frame_id == "robot"
    row = read_index_rows(out)["drive/000001"]
    assert (row["saved"], row["seconds"]) == ("grid bag", "0.100")


def test_all_frames_have_the_median_of_their_pitches(call: Call, drive: Path, out: Path) -> None:
    result = call("infer", drive, "--out", out, *CELLS)

    assert result.exit_code == 0, result.stderr
    comments = {path.read_text().splitlines()[0] for path in out.rglob("*.grid.yaml")}
    assert len(comments) == 1
    words = comments.pop().split()
    assert "median of 3 frames" in " ".join(words)
    true = math.degrees(math.atan((HEIGHT / 2 - (HORIZON * HEIGHT - 0.5)) / FOCAL))
    assert float(words[2]) == pytest.approx(true, abs=1.5)
    low, high = float(words[8].strip("(")), float(words[10].strip(")"))
    assert low <= float(words[2]) <= high > low


# --- what goes wrong --------------------------------------------------------------------


OTHER_SHAPE = "/camera/image_raw#1: is 160×60 pixels, the calibration 160×120"
NO_PITCH = "has no layout from this detector to estimate the pitch (give --set grid.pitch"


@pytest.mark.parametrize(
    ("source", "words", "problem", "grids"),
    [
        ("other shape", PITCHED, OTHER_SHAPE, 2),
        ("no lens", PITCHED, ": has no camera_info /camera/camera_info beside", 0),
        ("no lens", (*PITCHED, *settings(fov=60)), "", 1),
        ("drive", (*VIEW, *TRIANGLE), NO_PITCH, 0),
        ("streets", (*VIEW, *TRIANGLE), NO_PITCH, 0),
    ],
)
def test_what_no_grid_can_be_made_of_fails_alone_and_says_what_it_needs(
    source: str, words: Sequence[str], problem: str, grids: int, call: Call, streets: Path,
    drive: Path, tmp_path: Path, out: Path,
) -> None:  # fmt: skip
    (tmp_path / "other").mkdir()
    bare = {"/camera/image_raw": [raw_image(ROS2, street(3), "rgb8", FIRST)]}
    sources = {
        "other shape": lambda: write_drive(
            tmp_path / "other", "mcap", [street(3), street(4)[:60], street(5)], FOCAL
        ),
        "no lens": lambda: write_bag(tmp_path / "bare", bare),
        "drive": lambda: drive,
        "streets": lambda: streets,
    }

    result = call("infer", sources[source](), *words, "--out", out)

    assert result.exit_code == bool(problem)
    assert problem in result.stderr
    assert len(list(out.rglob("*.grid.npy"))) == grids
