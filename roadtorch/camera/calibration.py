"""Lenses and poses from foreign files: ROS camera_info, and KITTI's calibration."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import AliasChoices, BeforeValidator, Field
from torch import Tensor

from roadtorch.base.bounded import reason
from roadtorch.base.documents import ForeignDocument, read_document
from roadtorch.base.errors import ConfigError, DatasetError, InputError
from roadtorch.base.settings import build_settings
from roadtorch.camera.ground import COEFFICIENT_COUNTS, GroundCamera, Lens, make_pose

CAMERA_INFO_HINT = "give a file of camera_calibration or of ros2 topic echo --once on camera_info"

KITTI_ROWS = {"P2": 12, "R0_rect": 9, "Tr_cam_to_road": 12}
"""Rows read from KITTI's files, in the order of ``Calibration``, and the length of each."""

MODEL_ALIASES = {"fisheye": "equidistant", "": "pinhole", "none": "pinhole", "pinhole": "pinhole"}
"""Other names of the distortion models of ``COEFFICIENT_COUNTS``."""


def _matrix_values(matrix: Any) -> Any:
    """Return the numbers of a matrix as camera_calibration writes it; a plain list as it is."""
    return matrix.get("data") if isinstance(matrix, Mapping) else matrix


_Numbers = Annotated[list[float], BeforeValidator(_matrix_values)]


class _CameraInfo(ForeignDocument):
    width: int = Field(validation_alias=AliasChoices("image_width", "width"))
    height: int = Field(validation_alias=AliasChoices("image_height", "height"))
    matrix: _Numbers = Field(
        min_length=9, max_length=9, validation_alias=AliasChoices("camera_matrix", "k", "K")
    )
    distortion: _Numbers = Field(
        default=[], validation_alias=AliasChoices("distortion_coefficients", "d", "D")
    )
    distortion_model: str = ""


def read_camera_info(path: str | os.PathLike[str]) -> Lens:
    """Read the lens of a YAML file by camera_calibration, or of a printed CameraInfo message.

    K and D describe the images; R and P are ignored.

    Raises:
        ConfigError, DatasetError: naming the file when it cannot be read or describes no lens.
    """
    path = Path(path)
    try:
        import yaml
    except ImportError:
        hint = "pip install 'roadtorch[grid]'"
        raise ConfigError(path, "reading YAML needs PyYAML, which is missing", hint) from None
    with read_document(path, CAMERA_INFO_HINT) as text:
        try:
            document = next(yaml.safe_load_all(text.decode()), None)
        except yaml.YAMLError as error:
            raise ConfigError(path, f"is not YAML: {reason(error)}", CAMERA_INFO_HINT) from None
        info = _CameraInfo.model_validate(document)
    size = (info.width, info.height)
    return lens_from_camera_info(path, size, info.matrix, info.distortion, info.distortion_model)


def lens_from_camera_info(
    path: str | os.PathLike[str],
    size: tuple[int, int],
    matrix: Sequence[float],
    distortion: Sequence[float],
    model: str,
) -> Lens:
    """Return the lens of a CameraInfo message: width and height, K (9), D, distortion_model.

    Raises ConfigError naming the path (file, bag or topic) for an unknown model or number.
    """
    model = MODEL_ALIASES.get(model, model)
    if model not in COEFFICIENT_COUNTS:
        models = ", ".join(name for name in COEFFICIENT_COUNTS if name != "pinhole")
        raise ConfigError(path, f"distortion_model {model!r} is not known", f"known: {models}")
    names = ("width", "height", "focal_x", "centre_x", "focal_y", "centre_y")
    numbers = (*size, matrix[0], matrix[2], matrix[4], matrix[5])
    values: dict[str, Any] = dict(zip(names, numbers, strict=True))
    if any(distortion) and model != "pinhole":
        values |= {"model": model, "coefficients": tuple(distortion)}
    try:
        return build_settings(Lens, values)
    except ConfigError as error:
        problem = f"is not a valid lens: {error.where}: {error.problem}"
        raise ConfigError(path, problem, error.hint) from None


# --- KITTI ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Calibration:
    """Calibration of KITTI's left colour camera; matrices row by row.

    Attributes:
        projection: P2 (3, 4), rectified camera to image.
        rectification: R0_rect (3, 3).
        camera_to_road: Tr_cam_to_road (3, 4), metres; the road plane has y = 0.
    """

    projection: tuple[float, ...]
    rectification: tuple[float, ...]
    camera_to_road: tuple[float, ...]


def read_calibration(path: Path) -> Calibration:
    """Read P2, R0_rect and Tr_cam_to_road from a calibration file; other rows are ignored.

    Raises DatasetError naming file and row when the file is missing, a row has another length or
    non-finite numbers, or the road plane is invisible (a singular matrix).
    """
    with read_document(path, "give the image's calibration file") as text:
        lines = (line.partition(":") for line in text.decode().splitlines())
        words = {name.strip(): values.split() for name, _, values in lines}
        rows = {name: tuple(map(float, words.get(name, ()))) for name in KITTI_ROWS}
    for name, length in KITTI_ROWS.items():
        if len(rows[name]) != length or not np.isfinite(rows[name]).all():
            problem = f"{name} does not have {length} finite numbers"
            raise DatasetError(path, problem, "replace the file")
    calibration = Calibration(*rows.values())
    if torch.linalg.matrix_rank(_pad_to_4x4(calibration.camera_to_road, 4)) < 4:
        raise DatasetError(path, "Tr_cam_to_road has no inverse", "replace the file")
    homography = road_homography(calibration)
    if not homography.isfinite().all() or torch.linalg.matrix_rank(homography) < 3:
        problem = "its matrices project the road plane onto a line"
        raise DatasetError(path, problem, "replace the file")
    return calibration


def road_homography(calibration: Calibration) -> Tensor:
    """Return the homography (3, 3) float64 from (x, z, 1) to (u, v, 1) up to scale.

    Columns 0, 2 and 3 of P2 · R0_rect · Tr_cam_to_road⁻¹, as the plane has y = 0.
    """
    projection = torch.tensor(calibration.projection, dtype=torch.float64).view(3, 4)
    rectification = _pad_to_4x4(calibration.rectification, 3)
    road_to_camera = torch.linalg.inv(_pad_to_4x4(calibration.camera_to_road, 4))
    return (projection @ rectification @ road_to_camera)[:, [0, 2, 3]]


def _pad_to_4x4(values: tuple[float, ...], columns: int) -> Tensor:
    """Pad a matrix of three rows to (4, 4) with the identity."""
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :columns] = torch.tensor(values, dtype=torch.float64).view(3, columns)
    return matrix


def kitti_ground_camera(
    calibration: Calibration, width: int, height: int, mount: tuple[float, float] = (0.0, 0.0)
) -> GroundCamera:
    """Return KITTI's left colour camera over its road plane, for images of a size in pixels.

    The robot's frame begins below that camera, or such that it is at ``mount``; KITTI's road has x
    to the right, y down and z ahead, and counts pixels from one. Raises InputError if the optical
    axis misses the image: it is of another camera, or cropped.
    """
    projection = np.array(calibration.projection).reshape(3, 4)
    intrinsics = projection[:, :3]
    u, v = float(intrinsics[0, 2]), float(intrinsics[1, 2])  # the principal point, from one
    if not (1 <= u <= width and 1 <= v <= height):
        problem = f"is {width}×{height} pixels, the calibration's centre {u:.0f}, {v:.0f}"
        raise InputError("image", problem, "give images of that camera at their own size")
    camera_to_road = np.array(calibration.camera_to_road).reshape(3, 4)
    rectification = np.array(calibration.rectification).reshape(3, 3)
    rotation = camera_to_road[:, :3] @ np.linalg.inv(rectification)  # rectified camera to road
    centre = rotation @ -np.linalg.solve(intrinsics, projection[:, 3]) + camera_to_road[:, 3]
    road_to_robot = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    lens = Lens(
        width=width,
        height=height,
        focal_x=float(intrinsics[0, 0]),
        focal_y=float(intrinsics[1, 1]),
        centre_x=u - 1,
        centre_y=v - 1,
    )
    # The file's rotations are rounded, so that their inverse differs from their transpose.
    axes = np.linalg.inv(road_to_robot @ rotation)
    return GroundCamera(lens, make_pose(axes, np.array([*mount, -centre[1]])))
