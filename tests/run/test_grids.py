"""roadtorch grid, from real files to real files."""

from pathlib import Path

import numpy as np
import pytest

from roadtorch.camera.camera import Camera
from roadtorch.testing.scenes import render_scene, write_image
from tests.command import Call, read_index_rows
from tests.run.writers.test_files import load_map

VIEW = ("--height", 1.35, "--fov", 55, "--range", 20, "--side", 8, "--resolution", 0.2)

TRIANGLE = ("--detector", "prior:triangle")


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """Return a folder with a rendered street, and another in a subfolder."""
    for name, seed in (("a", 3), ("sub/b", 4)):
        write_image(tmp_path / "street" / f"{name}.png", render_scene(seed, 120, 160))
    return tmp_path / "street"


def test_every_image_gives_a_map(call: Call, street: Path, out: Path) -> None:
    result = call("grid", street, "--out", out, *VIEW, "--likelihood", "--image")

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
    assert (out / "a.grid.jpg").is_file()
    assert list(read_index_rows(out)) == ["a.png", "sub/b.png"]


def test_the_pitch_of_a_camera_file(call: Call, street: Path, tmp_path: Path, out: Path) -> None:
    path = tmp_path / "camera.toml"
    Camera(width=160, height=120, frames=10, horizon=0.4, seed_row=1).write(path)

    result = call("grid", street / "a.png", "--out", out, *VIEW, "--camera", path)

    assert result.exit_code == 0, result.stderr
    assert "row 0.400 of the camera's file" in (out / "a.grid.yaml").read_text()


INFO = """
image_width: {width}
image_height: 240
camera_matrix: {{data: [{focal}, 0, 160, 0, 300, 120, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{data: [-0.1, 0, 0, 0, 0]}}
"""


def test_camera_info_is_scaled_or_refused(call: Call, street: Path, tmp_path: Path) -> None:
    info, wrong = tmp_path / "info.yaml", tmp_path / "other.yaml"
    info.write_text(INFO.format(width=320, focal=300))
    wrong.write_text(INFO.format(width=300, focal=300))
    options = ("grid", street / "a.png", "--height", 1.35, "--pitch", 2, *TRIANGLE, "--camera-info")

    good = call(*options, info, "--out", tmp_path / "good")
    bad = call(*options, wrong, "--out", tmp_path / "bad")

    assert (good.exit_code, bad.exit_code) == (0, 1)
    assert "is 160×120 pixels, the calibration 300×240" in bad.stderr


def test_a_detector_without_layout_needs_a_pitch(call: Call, street: Path, out: Path) -> None:
    result = call("grid", street, "--out", out, *VIEW, "--detector", "cpf")

    assert result.exit_code == 1
    assert "has no layout from this detector to estimate the pitch" in result.stderr
