"""roadtorch camera, and the commands that take its file."""

import json
import tomllib
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner, Result

from roadtorch.base.image import read_image, to_pixels, write_rgb
from roadtorch.camera.camera import Camera
from roadtorch.cli import main
from roadtorch.inputs.find import locate_frames, read_frames
from roadtorch.road.ego import Ego, ego_car
from tests.command import Call, files_in
from tests.streets import drive, scene
from tests.videos import write_video

KEYS = ["width", "height", "frames", "horizon", "seed_row", "invariant_angle", "ego", "template"]


@pytest.fixture(scope="module")
def run(street: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """Run on the street; return the camera file and the result."""
    out = tmp_path_factory.mktemp("camera") / "camera.toml"
    return out, CliRunner().invoke(main, ["camera", str(street), "--out", str(out)])


@pytest.fixture(scope="module")
def camera_file(run: tuple[Path, Result]) -> Path:
    """Return the camera file."""
    return run[0]


def test_a_file_and_an_image_are_written(
    call: Call, street: Path, run: tuple[Path, Result]
) -> None:
    out, result = run

    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert lines[0].startswith("ego car: 1")
    assert lines[1].startswith("horizon: row 0.4")
    assert lines[2].startswith("12 frames of 160×120 pixels; wrote ")
    assert files_in(out.parent) == {"camera.toml", "camera.jpg"}
    assert list(tomllib.loads(out.read_text())) == KEYS
    assert read_image(out.with_name("camera.jpg")).shape == (3, 480, 1280)
    assert call("camera", street, "--out", out).exit_code == 0  # again, over its own


def test_a_video_shows_what_its_frames_show(call: Call, tmp_path: Path) -> None:
    frames = [to_pixels(frame) for frame in drive() for _ in range(2)]
    seconds = [number / 10 for number in range(len(frames))]
    video = tmp_path / "drive.avi"
    write_video(video, seconds, (120, 160), "mjpeg", lambda number, _: frames[number])

    result = call("camera", video, "--limit", 12, "--out", tmp_path / "camera.toml")

    assert result.exit_code == 0, result.output
    camera = Camera.read(tmp_path / "camera.toml")
    assert camera.frames == 12
    assert camera.seed_row == pytest.approx(0.82, abs=0.03)
    first = next(read_frames(locate_frames([str(video)], 12)))
    assert (first - drive()[0]).abs().mean() < 0.05


@pytest.mark.parametrize("name", ["camera.toml", "camera.jpg"])
def test_files_of_others_stay(name: str, call: Call, street: Path, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("x = 1")

    result = call("camera", street, "--out", tmp_path / "camera.toml")

    assert result.exit_code == 2
    assert f"{path}: exists and" in result.output
    assert path.read_text() == "x = 1"
    assert len(list(tmp_path.iterdir())) == 1


CAMERA_INFO = """
image_width: 320
image_height: 240
camera_matrix: {data: [100, 0, 159.5, 0, 100, 119.5, 0, 0, 1]}
distortion_model: fisheye
distortion_coefficients: {data: [0.01, 0, 0, 0]}
"""


def test_a_calibration_reaches_camera_file_infer_and_grid(
    call: Call, street: Path, tmp_path: Path
) -> None:
    (tmp_path / "info.yaml").write_text(CAMERA_INFO)
    file, image = tmp_path / "camera.toml", street / "00.png"

    estimate = ("camera", street, "--camera-info", tmp_path / "info.yaml", "--out", file)
    call(*estimate)
    file.write_text(f"{file.read_text()}\n[grid]\nheight = 1.2\n")
    made = call(*estimate)  # keeps the height
    options = ("--camera", file, "--detector", "prior:rows", "--out")
    found = call("infer", image, *options, tmp_path / "roads")
    mapped = call("infer", image, *options, tmp_path / "grids", "--save", "grid")

    assert [made.exit_code, found.exit_code, mapped.exit_code] == [0, 0, 0], mapped.output
    lens = Camera.read(file).lens
    assert lens is not None
    assert (lens.model, lens.width, lens.focal_x) == ("equidistant", 160, 50)
    assert "[rectification.lens]" in (tmp_path / "roads" / "config.toml").read_text()
    assert '# model = "equidistant"' in (tmp_path / "grids" / "config.toml").read_text()


def test_of_few_frames_the_file_has_the_lens_alone(
    call: Call, street: Path, tmp_path: Path
) -> None:
    (tmp_path / "info.yaml").write_text(CAMERA_INFO)
    file = tmp_path / "camera.toml"

    made = call("camera", street / "00.png", "--camera-info", tmp_path / "info.yaml", "--out", file)

    assert made.exit_code == 0, made.output
    camera = Camera.read(file)
    assert (camera.frames, camera.horizon, camera.ego) == (1, None, Ego())
    assert camera.lens is not None
    roads = call("infer", street / "00.png", "--camera", file, "--out", tmp_path / "roads")
    assert roads.exit_code == 0, roads.output


# --- commands with --camera ---------------------------------------------------------------


def test_infer_leaves_the_car_out(
    call: Call, street: Path, camera_file: Path, tmp_path: Path
) -> None:
    foreign = tmp_path / "foreign.png"
    write_rgb(foreign, scene(40, 120, 160).image)
    out = tmp_path / "out"

    result = call(
        *("infer", street / "00.png", foreign, "--detector", "prior:rows", "--camera", camera_file),
        *("--out", out, "--save", "mask"),
    )

    assert result.exit_code == 1
    assert f"failed: {foreign}: does not show this camera's ego car" in result.stderr
    mask = read_image(out / "00.mask.png")[0] > 0
    car = ego_car(torch.zeros(3, 120, 160), Camera.read(camera_file).ego)
    assert not mask[car].any()
    assert mask[60:][~car[60:]].all()
    assert "outline = [" in (out / "config.toml").read_text()


def test_evaluate_takes_it_for_all(
    call: Call, street: Path, camera_file: Path, tmp_path: Path
) -> None:
    root = tmp_path / "set"
    (root / "images").mkdir(parents=True)
    (root / "masks").mkdir()
    car = ego_car(torch.zeros(3, 120, 160), Camera.read(camera_file).ego)
    for number in range(2):
        write_rgb(root / "images" / f"{number}.png", read_image(street / f"{number:02d}.png"))
        road = scene(number, 120, 160, horizon=0.42, dusk=0.0).road & ~car
        write_rgb(root / "masks" / f"{number}.png", road.expand(3, -1, -1).float())

    result = call(
        *("evaluate", "folder", root, "--detector", "prior:rows", "--detector", "cpf"),
        *("--camera", camera_file, "--out", tmp_path / "out"),
    )

    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert "--camera" in written["command"]
    for name in ("prior:rows", "cpf"):
        outline = written["detectors"][name]["settings"]["ego"]["outline"]
        assert tuple(outline) == Camera.read(camera_file).ego.outline
