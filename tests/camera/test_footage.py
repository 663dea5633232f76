"""Estimating a camera from footage, rendered and real, and the horizon from a layout."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.base.image import read_image
from roadtorch.camera.camera import Camera
from roadtorch.camera.footage import estimate_camera
from roadtorch.camera.gradients import estimate_horizon
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.entry import DetectorSettings
from roadtorch.detectors.fusion import UntrainedFusionSettings
from roadtorch.detectors.illuminant import IlluminantSettings
from roadtorch.imaging.resize import resize_maps
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.road.ego import ego_car
from roadtorch.testing.scenes import render_scene, sample_street
from tests.streets import bonnet, drive, scene

# --- the ego car ----------------------------------------------------------------------------


def test_the_bonnet_is_found_where_it_is_painted_and_none_where_there_is_none() -> None:
    image, painted = drive()[0], bonnet(120, 160)

    ego = ego_car(image, estimate_camera(drive()).ego)

    assert (ego & painted).sum() > 0.85 * (ego | painted).sum()
    assert not ego_car(image, estimate_camera(drive(rise=0)).ego).any()


# --- the camera -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def camera() -> Camera:
    return estimate_camera(drive())


def test_horizon_and_seed_row_come_back_from_a_file(camera: Camera, tmp_path: Path) -> None:
    assert (camera.width, camera.height, camera.frames) == (160, 120, 12)
    assert camera.horizon == pytest.approx(0.42, abs=0.06)
    assert camera.seed_row == pytest.approx(0.82, abs=0.03)
    camera.write(tmp_path / "camera.toml")
    assert Camera.read(tmp_path / "camera.toml") == camera


def test_its_own_images_pass_at_any_size_and_others_are_refused(camera: Camera) -> None:
    for image in (*drive(), resize_maps(drive()[3], (240, 320)).clamp(0, 1)):
        camera.check(image)
    with pytest.raises(InputError, match="image: does not show this camera's ego car"):
        camera.check(scene(40, 120, 160).image)
    with pytest.raises(InputError, match="image: is 160×90 pixels, the camera's footage 160×120"):
        camera.check(scene(40, 90, 160).image)


def test_detectors_take_what_they_can_of_it(camera: Camera) -> None:
    assert set(camera.settings_for(DetectorSettings)) == {"ego"}
    angle = camera.settings_for(IlluminantSettings)["invariant_angle"]
    assert angle == camera.invariant_angle
    assert camera.settings_for(UntrainedFusionSettings)["labeller"]["horizon"] == camera.horizon
    detector = load_detector("fusion:untrained", camera=camera, labeller={"horizon": 0.3})
    assert detector.settings.ego == camera.ego
    assert detector.settings.labeller.horizon == 0.3  # type: ignore[attr-defined]


def test_coarse_levels_do_not_move_the_angle(camera: Camera) -> None:
    large = (resize_maps(frame, (480, 640)).clamp(0, 1) for frame in drive())
    angle = estimate_camera([(32 * frame).round() / 32 for frame in large]).invariant_angle

    assert angle == pytest.approx(camera.invariant_angle, abs=10)


# --- footage that is not of one camera -------------------------------------------------------


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (drive()[:1], "footage: has one frame"),
        (drive()[:4], "footage: has 4 frames"),
        ([drive()[0]] * 12, "footage: is static"),
        ([*drive(), *drive(rise=0.1, height=90)], "several cameras: 160×120 and 160×90 pixels"),
        ([*drive(), *drive(rise=0)], "several cameras: 12 of 24 frames do not show the ego car"),
    ],
)
def test_footage_of_several_cameras_or_none_is_refused(frames: list[Tensor], message: str) -> None:
    with pytest.raises(InputError, match=message):
        estimate_camera(frames)


# --- real cameras ---------------------------------------------------------------------------


@pytest.mark.data
@pytest.mark.parametrize("prefix", ["udhwy", "udlane", "driveai_us", "dnit_br", "s2tld", "lund"])
def test_a_real_bonnet_is_found_and_none_where_there_is_none(prefix: str, data_root: Path) -> None:
    files = sorted((data_root / "unlabelled_free").glob(f"{prefix}_*.jpg"))
    count, seed_row = (20, 0.95) if prefix == "udhwy" else (12, 1.0)

    camera = estimate_camera([read_image(path) for path in files[:count]])

    assert camera.seed_row == pytest.approx(seed_row, abs=0.025)
    assert bool(camera.ego.outline) == (prefix == "udhwy")


# --- the horizon of an image -----------------------------------------------------------


def potentials(layout: Tensor) -> Tensor:
    return torch.nn.functional.one_hot(layout.long(), 3).permute(2, 0, 1).float()


@pytest.mark.parametrize("seed", [0, 3, 4, 14])
def test_a_true_layout_gives_the_horizon(seed: int) -> None:
    scene = render_scene(seed)

    horizon = estimate_horizon(scene.image, potentials(scene.layout))

    true = sample_street(np.random.default_rng(seed)).horizon
    assert horizon.row == pytest.approx(true, abs=0.04)
    assert horizon.deviation >= 0.025


@pytest.mark.parametrize(
    ("top", "message"),
    [
        (119, "too little ground"),
        (0, "ground up to its upper edge"),
        (110, "lines that meet at row"),
    ],
)
def test_a_layout_without_a_horizon_is_refused(top: int, message: str) -> None:
    image = render_scene(3, 120, 160).image
    layout = torch.zeros(120, 160)
    layout[top:] = HORIZONTAL
    layout[:, : (150 if message.startswith("too") else 0)] = 0

    with pytest.raises(InputError, match=message):
        estimate_horizon(image, potentials(layout))
