"""Changed inputs between two runs of every command: results are redone, or the run is refused.

The second run leaves the files of a run in a new folder, or is refused with the name of the changed
file. Size and modification time of the file are kept where possible: only its bytes differ.
"""

import os
import shutil
from pathlib import Path
from unittest.mock import Mock

import cv2
import pytest
import torch
from click.testing import Result

from roadtorch.annotate.session import open_session
from roadtorch.base.image import write_mask, write_rgb
from roadtorch.camera.camera import Camera, Ego
from roadtorch.detectors.catalogue import load_detector
from roadtorch.testing.scenes import render_scene, write_image
from roadtorch.train.run import TrainingRun
from tests.command import Call, bytes_in, files_in
from tests.networks import write_random_network
from tests.reference import bev
from tests.streets import drive
from tests.train.runs import IMAGES
from tests.videos import write_video

SIZE = (48, 64)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Return a folder with the inputs of every command."""
    root = tmp_path / "in"
    for seed, name in enumerate(("um_000000", "umm_000003")):
        write_image(root / "image_2" / f"{name}.png", render_scene(seed, 120, 160))
        (root / "calib").mkdir(exist_ok=True)
        rows = bev.made_up_rows(pitch=0.02)
        (root / "calib" / f"{name}.txt").write_text(bev.calibration_text(rows))
        write_image(root / "streets" / f"street_{seed}.png", render_scene(seed, *SIZE))
    (root / "drive").mkdir()
    write_mask(root / "ego.png", torch.arange(48)[:, None].expand(SIZE) > 40)
    camera = Camera(width=64, height=48, frames=10, horizon=0.4, seed_row=0.9, ego=Ego(bottom=0.2))
    camera.write(root / "camera.toml")
    (root / "config.toml").write_text('detector = "prior:rows"\nthreshold = 0.4\n')
    (root / "train.toml").write_text(IMAGES)
    write_random_network(root / "weights.safetensors", 0)
    return root


OTHER_TEXT = {
    "camera.toml": ("0.", "0.1"),
    "config.toml": ("0.4", "0.6"),
    "calib/um_000000.txt": ("1.3000", "1.4000"),  # the focal length
}


def change(root: Path, name: str) -> None:
    """Change the contents of a file, and keep its modification time."""
    path = root / name
    status = path.stat()
    if path.suffix == ".png":
        pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert pixels is not None
        cv2.imwrite(str(path), pixels[::-1])
    elif path.suffix == ".safetensors":
        write_random_network(path, 1)
    else:
        original = path.read_text()
        path.write_text(original.replace(*OTHER_TEXT[name]))
        assert path.read_text() != original
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def split_command(root: Path, line: str) -> list[str]:
    return line.replace("@", f"{root}/").split()


# --- an image at a time -----------------------------------------------------------------

EGO = "--set ego.mask=@ego.png"
WEIGHTS = "--detector fusion --set weights.file=@weights.safetensors"
ROWS = "--detector prior:rows"
GREY = "--detector grey-uniformity"
TRAIN = "train --config @train.toml --images @streets --threads 1"
ADAPT = "adapt @drive --threads 1 --set network.height=64 --set network.width=96"
FOV = "--set grid.fov=55"
GRID = f"{ROWS} --save grid --set grid.height=1.35 --set grid.range=10 --set grid.side=4"


@pytest.mark.parametrize(
    ("line", "name"),
    [
        (f"infer @streets {ROWS}", "streets/street_0.png"),
        (f"infer @streets {ROWS} {EGO}", "ego.png"),
        (f"infer @streets {WEIGHTS}", "weights.safetensors"),
        (f"infer @streets {GRID} {FOV} --set grid.pitch=3 {EGO}", "ego.png"),
        ("label @streets", "streets/street_0.png"),
        (f"evaluate kitti-road @ --submit {GREY}", "image_2/um_000000.png"),
        (f"evaluate kitti-road @ --submit {GREY}", "calib/um_000000.txt"),
        (f"evaluate kitti-road @ --submit {WEIGHTS}", "weights.safetensors"),
    ],
)
def test_as_in_a_new_folder(call: Call, root: Path, tmp_path: Path, line: str, name: str) -> None:
    words = split_command(root, line)
    assert call(*words, "--out", tmp_path / "out").exit_code == 0
    change(root, name)

    again = call(*words, "--out", tmp_path / "out")

    assert again.exit_code == 0, again.stderr
    assert "0 done" not in again.stderr
    assert call(*words, "--out", tmp_path / "new").exit_code == 0
    assert files_in(tmp_path / "out") == files_in(tmp_path / "new")
    contents = [without_archives(bytes_in(tmp_path / folder)) for folder in ("out", "new")]
    assert contents[0] == contents[1]


@pytest.mark.parametrize(
    ("line", "names"),
    [
        (f"infer @streets {ROWS}", "config.toml index.csv run.json street_1.mask.png"),
        (f"infer @streets {ROWS} --overwrite", "config.toml index.csv street_0.overlay.jpg"),
        (f"infer @streets {ROWS} --save polygons", "coco.json street_0.coco.json"),
        (f"infer @streets {GREY} --save npy,cues", "street_0.cue.x.png street_1.x.npy"),
        (
            f"infer @street.avi {ROWS} --save overlay,mask",
            "street.overlay.mp4 street/000001.mask.png",
        ),
        (f"infer @street.avi {ROWS} --save bag", "street.road street.road/metadata.yaml"),
        (f"infer @streets {GRID} {FOV} --set grid.pitch=3", "street_0.grid.yaml street_1.grid.npy"),
        ("label @streets", "street_0.png config.toml"),
        (f"evaluate kitti-road @ --submit {GREY}", "submission.zip um_road_000000.png"),
        (
            f"evaluate kitti-road @ --tune {GREY}",
            "metrics.json montage.x.best.jpg grey-uniformity.toml",
        ),
        (TRAIN, "weights.safetensors log.csv prepared/x weights.md"),
        (ADAPT, "camera.toml weights.safetensors frames/x adaptation.html"),
    ],
)
def test_files_of_others_stay(
    call: Call, root: Path, tmp_path: Path, line: str, names: str
) -> None:
    write_video(root / "street.avi", codec="mjpeg")
    for name in names.split():
        out = tmp_path / f"out of {Path(name).name}"
        (out / name).parent.mkdir(parents=True)
        (out / name).write_text("file\n")

        result = call(*split_command(root, line), "--out", out)

        assert result.exit_code == 2, result.output
        assert f"{out / name.partition('/')[0]}" in result.stderr
        assert files_in(out) == {name}
        assert (out / name).read_text() == "file\n"


@pytest.mark.parametrize(
    ("line", "other"),
    [
        (f"infer @streets {ROWS}", "streets"),
        ("label @streets", "streets"),
        (f"infer @street.avi {ROWS}", "street.avi"),
        (f"infer @street.avi {ROWS} --save mask", "street.avi"),
    ],
)
def test_results_of_another_input_stay(
    call: Call, root: Path, tmp_path: Path, line: str, other: str
) -> None:
    (tmp_path / "far").mkdir()
    out = tmp_path / "out"

    def run_in(folder: Path, *options: str) -> Result:
        return call(*split_command(folder, line), "--out", out, *options)

    write_video(root / "street.avi", codec="mjpeg")
    assert run_in(root).exit_code == 0
    contents = bytes_in(out)
    shutil.copytree(root, tmp_path / "moved")
    write_video(tmp_path / "far" / "street.avi", (0.0, 0.1), codec="mjpeg")
    for seed in (2, 3):
        image = tmp_path / "far" / "streets" / f"street_{seed - 2}.png"
        write_image(image, render_scene(seed, *SIZE))

    refused = run_in(tmp_path / "far")

    assert refused.exit_code == 2
    assert f"is a result of ../in/{other}" in refused.stderr
    assert bytes_in(out) == contents
    same = run_in(tmp_path / "moved")
    assert (same.exit_code, "0 done" in same.stderr) == (0, True), same.stderr
    assert run_in(tmp_path / "far", "--overwrite").exit_code == 0


def without_archives(files: dict[str, bytes]) -> dict[str, bytes]:
    """Leave out archives, whose members have dates."""
    return {name: data for name, data in files.items() if not name.endswith(".zip")}


# --- what is refused, and what the page shows --------------------------------------------

OTHER_SETTINGS = "holds results of other settings (config.toml) (give another --out, or"


@pytest.mark.parametrize(
    ("line", "name", "error"),
    [
        ("infer @streets --config @config.toml", "config.toml", OTHER_SETTINGS),
        (f"infer @streets {GREY} --camera @camera.toml", "camera.toml", OTHER_SETTINGS),
        (f"infer @streets {GRID} {FOV} --camera @camera.toml", "camera.toml", OTHER_SETTINGS),
        (TRAIN, "streets/street_0.png", "holds a run with other images"),
        (
            f"{TRAIN} --set teacher.detector=fusion --set teacher.weights=@weights.safetensors",
            "weights.safetensors",
            "run with other settings",
        ),
        (
            f"{TRAIN} --set initial_weights=@weights.safetensors",
            "weights.safetensors",
            "run with other settings",
        ),
        (f"{ADAPT} --set teacher.detector=labeller", "drive/00.png", "holds frames of other"),
        (
            f"{ADAPT} --set teacher.detector=fusion --set teacher.weights=@weights.safetensors",
            "weights.safetensors",
            "run with other settings",
        ),
    ],
)
def test_settings_of_another_file_and_a_training_with_another_file_are_refused(
    line: str, name: str, error: str, call: Call, root: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    for number, frame in enumerate(drive()):
        write_rgb(root / f"drive/{number:02d}.png", frame)
    words = [*split_command(root, line), "--out", tmp_path / "out"]
    with monkeypatch.context() as cut:
        cut.setattr(TrainingRun, "_train", Mock(side_effect=KeyboardInterrupt))
        assert bool(call(*words).exit_code) == (not line.startswith("infer"))
    assert list((tmp_path / "out").rglob("run.json"))
    change(root, name)

    again = call(*words)

    assert again.exit_code == 2
    assert error in again.stderr


@pytest.mark.parametrize("name", ["streets/street_0.png", "weights.safetensors", "ego.png"])
def test_the_page_shows_what_a_new_folder_would(root: Path, tmp_path: Path, name: str) -> None:
    def odds(out: str) -> torch.Tensor:
        weights, ego = str(root / "weights.safetensors"), str(root / "ego.png")
        detector = load_detector("fusion", weights={"file": weights}, ego={"mask": ego})
        (tmp_path / out).mkdir(exist_ok=True)
        return open_session(root / "streets", tmp_path / out, detector).view("street_0.png").odds

    original = odds("out")
    change(root, name)

    after = odds("out")

    assert not torch.equal(original, after)
    assert torch.equal(after, odds("new"))
