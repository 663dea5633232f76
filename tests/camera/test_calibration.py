"""Lenses of foreign calibration files: camera_calibration, OpenCV, Kalibr, messages, KITTI."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from roadtorch.base.errors import RoadtorchError
from roadtorch.camera.calibration import read_calibration, read_camera_info
from tests.reference import bev as reference

CALIBRATION_YAML = """
image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320.5, 0, 510, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.3, 0.1, 0.001, -0.001, 0]}
"""
OPENCV_YAML = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.e+02, 0., 3.2050000000000000e+02, 0., 510., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -3.0e-01, 1e-1, 1e-05, -2e-06, 0. ]
"""
KALIBR_YAML = """
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.3, 0.1, 0.001, -0.001]
  distortion_model: radtan
  intrinsics: [500, 510.0, 320.5, 240.0]
  resolution: [640, 480]
"""
PRINTED_MESSAGE = """
header:
  frame_id: camera
height: 480
width: 640
distortion_model: equidistant
d: [0.05, -0.01, 0.001, 0.0]
k: [500.0, 0.0, 320.5, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
---
"""


FIVE, TINY_TANGENTIAL = (-0.3, 0.1, 0.001, -0.001, 0), (-0.3, 0.1, 1e-05, -2e-06, 0)
FISHEYE = (-0.3, 0.1, 1e-05, 0)


def test_a_region_of_the_sensor_moves_the_centre(tmp_path: Path) -> None:
    region = "roi: {x_offset: 160, y_offset: 100, width: 320, height: 240, do_rectify: false}"
    (tmp_path / "info.yaml").write_text(PRINTED_MESSAGE.replace("---", region))

    lens = read_camera_info(tmp_path / "info.yaml")

    assert (lens.width, lens.height, lens.centre_x, lens.centre_y) == (320, 240, 160.5, 140)


@pytest.mark.parametrize(
    ("text", "model", "coefficients"),
    [
        (CALIBRATION_YAML, "plumb_bob", (-0.3, 0.1, 0.001, -0.001, 0)),
        (CALIBRATION_YAML.replace("-0.3, 0.1", "-0.3"), "plumb_bob", (-0.3, 0.001, -0.001, 0)),
        (CALIBRATION_YAML.replace("-0.3, 0.1, 0.001, -0.001, 0", "0,0,0"), "pinhole", ()),
        (CALIBRATION_YAML.replace("0.001, -0.001", "1e-05, -2E-6"), "plumb_bob", TINY_TANGENTIAL),
        (CALIBRATION_YAML.replace("distortion_model: plumb_bob", ""), "plumb_bob", FIVE),
        (CALIBRATION_YAML.replace("plumb_bob", "pinhole"), "plumb_bob", FIVE),
        (PRINTED_MESSAGE, "equidistant", (0.05, -0.01, 0.001, 0)),
        (PRINTED_MESSAGE.replace("0.05, -0.01, 0.001", "0, 0, 0"), "equidistant", (0, 0, 0, 0)),
        (OPENCV_YAML, "plumb_bob", TINY_TANGENTIAL),
        (f"{OPENCV_YAML}fisheye_model: 1".replace("-2e-06, 0.", "0."), "equidistant", FISHEYE),
        (KALIBR_YAML, "plumb_bob", (-0.3, 0.1, 0.001, -0.001)),
    ],
)
def test_info_files(text: str, model: str, coefficients: tuple[float, ...], tmp_path: Path) -> None:
    path = tmp_path / "info.yaml"
    path.write_text(text)

    lens = read_camera_info(path)

    assert (lens.width, lens.height, lens.focal_x, lens.focal_y) == (640, 480, 500, 510)
    assert (lens.centre_x, lens.centre_y) == (320.5, 240)
    assert (lens.model, lens.coefficients) == (model, coefficients)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CALIBRATION_YAML.replace("500, 0,", "0, 0,"), "is not a valid lens: focal_x"),
        (CALIBRATION_YAML.replace("plumb_bob", "kannala"), "'kannala' is not known"),
        (CALIBRATION_YAML.replace("-0.3, ", ".nan, "), "input should be a finite number"),
        (CALIBRATION_YAML.replace("-0.3, 0.1, 0.001", "-0.3"), "plumb_bob has 4 or 5 coefficients"),
        ("!!python/object/apply:os.system ['true']", "is not YAML"),
        (CALIBRATION_YAML.replace("0, 0, 1]", "0, 0, 2]"), "K ends in 0, 510, 240, 0, 0, 2"),
        (CALIBRATION_YAML.replace("0, 0, 1]", "0, 0, 0]"), "K ends in 0, 510, 240, 0, 0, 0"),
        (CALIBRATION_YAML.replace("500, 0, 320.5", "500, 9, 320.5"), "K has a skew of 9"),
        (CALIBRATION_YAML.replace("0, 510, 240", "9, 510, 240"), "K ends in 9, 510, 240, 0, 0, 1"),
        (CALIBRATION_YAML.replace("500, 0, 320.5", ".8, 0, .5"), "K is centred at 0.5, 240"),
        (CALIBRATION_YAML.replace("500, 0, 320.5", "1000, 0, 639"), "K is centred at 639, 240"),
        (CALIBRATION_YAML.replace("plumb_bob", "''").replace("1, 0.001", "1"), "has 4 distortion"),
        (f"{KALIBR_YAML}{KALIBR_YAML.replace('cam0', 'cam1')}", "has 2 cameras"),
        (KALIBR_YAML.replace("pinhole", "omni"), "input should be 'pinhole', 'omni' was given"),
    ],
)
def test_other_files_are_refused_by_name(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "info.yaml").write_text(text)

    with pytest.raises(RoadtorchError, match=r"info\.yaml: ") as error:
        read_camera_info(tmp_path / "info.yaml")
    assert message in str(error.value)


# --- KITTI ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("row", "change", "message"),
    [
        ("P2", lambda matrix: matrix * (-1, 1, 1, 1), "P2 has the focal lengths -130 and 130"),
        ("P2", lambda matrix: matrix + [[0], [9], [0]] * np.eye(3, 4)[0], "P2 has the shear 9"),
        ("P2", lambda matrix: matrix * 2, "P2 does not end in 0 0 1"),
        ("P2", lambda matrix: matrix * [[1], [1], [0]], "P2 does not end in 0 0 1"),
        ("R0_rect", lambda matrix: matrix * 0, "R0_rect is no rotation"),
        ("Tr_cam_to_road", lambda matrix: matrix * (-1, 1, 1, 1), "Tr_cam_to_road is no rotation"),
        ("Tr_cam_to_road", lambda matrix: matrix * (1, 1, 1, -1), "Tr_cam_to_road has the camera"),
        ("Tr_cam_to_road", lambda matrix: matrix * (1, 1, 1, 1000), "16[0-9.]+ m above the road"),
    ],
)
def test_rows_of_no_camera_above_a_road_are_refused_by_name(
    row: str, change: Callable[[np.ndarray], np.ndarray], message: str, tmp_path: Path
) -> None:
    rows = reference.made_up_rows()
    (tmp_path / "um.txt").write_text(reference.calibration_text({**rows, row: change(rows[row])}))

    with pytest.raises(RoadtorchError, match=rf"um\.txt: .*{message}"):
        read_calibration(tmp_path / "um.txt")
