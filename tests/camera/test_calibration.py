"""Files of others: ROS camera_info in its two forms, and KITTI against the bird's-eye view."""

from pathlib import Path

import numpy as np
import pytest
import torch

from roadtorch.base.errors import InputError, RoadtorchError
from roadtorch.camera.birds_eye import cell_to_road, project
from roadtorch.camera.calibration import (
    Calibration,
    kitti_ground_camera,
    read_camera_info,
    road_to_image,
)
from tests.reference import bev as reference

WRITTEN = """
image_width: 640
image_height: 480
camera_name: front
camera_matrix:
  rows: 3
  cols: 3
  data: [500, 0, 320.5, 0, 510, 240, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.3, 0.1, 0.001, -0.001, 0]
"""
PRINTED = """
header:
  frame_id: camera
height: 480
width: 640
distortion_model: equidistant
d: [0.05, -0.01, 0.001, 0.0]
k: [500.0, 0.0, 320.5, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
---
"""


def info(folder: Path, text: str) -> Path:
    path = folder / "info.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "model", "coefficients"),
    [
        (WRITTEN, "plumb_bob", (-0.3, 0.1, 0.001, -0.001, 0)),
        (WRITTEN.replace("-0.3, 0.1", "-0.3"), "plumb_bob", (-0.3, 0.001, -0.001, 0)),
        (WRITTEN.replace("-0.3, 0.1, 0.001, -0.001, 0", "0,0,0"), "pinhole", ()),
        (PRINTED, "equidistant", (0.05, -0.01, 0.001, 0)),
    ],
)
def test_what_camera_calibration_writes_and_a_printed_message(
    text: str, model: str, coefficients: tuple[float, ...], tmp_path: Path
) -> None:
    lens = read_camera_info(info(tmp_path, text))

    assert (lens.width, lens.height, lens.focal_x, lens.focal_y) == (640, 480, 500, 510)
    assert (lens.centre_x, lens.centre_y) == (320.5, 240)
    assert (lens.model, lens.coefficients) == (model, coefficients)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (WRITTEN.replace("500, 0,", "0, 0,"), "holds no calibrated camera matrix"),
        (WRITTEN.replace("plumb_bob", "kannala"), "'kannala' is not known"),
        (WRITTEN.replace("-0.3, ", ".nan, "), "distortion_coefficients holds what is not finite"),
        (WRITTEN.replace("-0.3, 0.1, 0.001", "-0.3"), "plumb_bob has 4 or 5 coefficients"),
        ("!!python/object/apply:os.system ['true']", "is not YAML"),
    ],
)
def test_other_files_are_refused_by_name(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(RoadtorchError, match=r"info\.yaml: ") as problem:
        read_camera_info(info(tmp_path, text))
    assert told in str(problem.value)


# --- KITTI ------------------------------------------------------------------------------


def centre(calibration: Calibration) -> np.ndarray:
    """The colour camera in the road's frame: the point that the whole projection forgets."""
    rectify, pose = np.eye(4), np.eye(4)
    rectify[:3, :3] = np.reshape(calibration.rectification, (3, 3))
    pose[:3] = np.reshape(calibration.camera_to_road, (3, 4))
    whole = np.reshape(calibration.projection, (3, 4)) @ rectify @ np.linalg.inv(pose)
    null = np.linalg.svd(whole)[2][-1]
    return null[:3] / null[3]


def in_the_robots_frame(calibration: Calibration, x: np.ndarray, z: np.ndarray) -> np.ndarray:
    foot = centre(calibration)
    return np.stack([z - foot[2], foot[0] - x, np.zeros_like(x)], -1).reshape(-1, 3)


def test_the_ground_points_are_those_of_the_birds_eye_view() -> None:
    calibration = reference.calibration(reference.made_up_rows())
    camera = kitti_ground_camera(calibration, 160, 120)
    x, z = torch.broadcast_tensors(
        *cell_to_road(torch.arange(0, 800, 7)[:, None], torch.arange(0, 400, 7)[None])
    )
    u, v = project(road_to_image(calibration), x, z)

    pixels, _ = camera.pixels_of(in_the_robots_frame(calibration, x.numpy(), z.numpy()))

    assert pixels == pytest.approx(torch.stack([u - 1, v - 1], -1).reshape(-1, 2).numpy(), abs=1e-6)
    assert camera.pose.position[:2] == (0, 0)


def test_a_picture_of_another_camera_is_refused() -> None:
    with pytest.raises(InputError, match="the calibration's middle"):
        kitti_ground_camera(reference.calibration(reference.made_up_rows()), 20, 20)
