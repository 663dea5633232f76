"""Lenses and poses from the files of others: ROS camera_info, and KITTI's calibration."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.errors import ConfigError, DatasetError, InputError
from roadtorch.base.settings import build_settings
from roadtorch.camera.ground import COEFFICIENTS, GroundCamera, Lens, pose_of

REMEDY = "give what camera_calibration writes, or ros2 topic echo --once of the camera_info topic"

ROWS = {"P2": 12, "R0_rect": 9, "Tr_cam_to_road": 12}
"""Rows of KITTI's files that are read, as ``Calibration`` has them, and how many numbers each."""

MODEL_NAMES = {"fisheye": "equidistant", "": "pinhole", "none": "pinhole", "pinhole": "pinhole"}
"""Names of models of distortion besides those of ``COEFFICIENTS``."""


def read_camera_info(path: str | os.PathLike[str]) -> Lens:
    """The lens in a YAML file: as camera_calibration writes it, or a printed CameraInfo message.

    The pictures are taken as the camera gives them: K and D count, not R and P. Raises
    ConfigError naming the file when it is not such a file, InputError when it cannot be read.
    """
    path = Path(path)
    values = _first_document(path)
    if not isinstance(values, Mapping):
        raise ConfigError(path, "holds no camera_info", REMEDY)
    matrix = _numbers(path, values, ("camera_matrix", "k", "K"))
    if len(matrix) != 9 or matrix[0] <= 0:
        raise ConfigError(path, "holds no calibrated camera matrix (K)", REMEDY)
    bent = _numbers(path, values, ("distortion_coefficients", "d", "D"))
    sides = []
    for names in (("image_width", "width"), ("image_height", "height")):
        sides.append(next((values[name] for name in names if name in values), None))
        if not isinstance(sides[-1], int) or sides[-1] < 1:
            raise ConfigError(path, f"{names[0]} is missing, or no number of pixels", REMEDY)
    model = str(values.get("distortion_model", ""))
    return lens_of_info(path, (sides[0], sides[1]), matrix, bent, model)


def lens_of_info(
    path: str | os.PathLike[str],
    size: tuple[int, int],
    matrix: Sequence[float],
    bent: Sequence[float],
    model: str,
) -> Lens:
    """The lens of what a CameraInfo message says: width and height, K (9), D, distortion_model.

    Raises ConfigError naming the path, of the file or bag that says it, where it is no lens.
    """
    model = MODEL_NAMES.get(model, model)
    if model not in COEFFICIENTS:
        known = ", ".join(name for name in COEFFICIENTS if name != "pinhole")
        raise ConfigError(path, f"distortion_model {model!r} is not known", f"known: {known}")
    straight = not any(bent) or model == "pinhole"
    names = ("width", "height", "focal_x", "centre_x", "focal_y", "centre_y")
    values = dict(zip(names, (*size, matrix[0], matrix[2], matrix[4], matrix[5]), strict=True))
    bend = {} if straight else {"model": model, "coefficients": tuple(bent)}
    try:
        return build_settings(Lens, {**values, **bend})
    except ConfigError as problem:
        what = f"is no lens: {problem.where}: {problem.what}"
        raise ConfigError(path, what, problem.remedy) from None


def _first_document(path: Path) -> Any:
    """The first document of a YAML file; ConfigError when it is not YAML."""
    try:
        import yaml
    except ImportError:
        remedy = "pip install 'roadtorch[grid]'"
        raise ConfigError(path, "reading YAML needs PyYAML, which is missing", remedy) from None
    try:
        return next(yaml.safe_load_all(read_regular(path).decode()), None)
    except OSError as problem:
        raise InputError(path, f"cannot be read: {problem.strerror}", REMEDY) from None
    except (yaml.YAMLError, RecursionError, ValueError) as problem:
        mark = getattr(problem, "problem_mark", None)
        line = f"line {mark.line + 1}: " if mark else ""
        raise ConfigError(path, f"is not YAML: {line}{reason(problem)}", REMEDY) from None


def _numbers(path: Path, values: Mapping[str, Any], names: tuple[str, ...]) -> list[float]:
    """The numbers under the first of the names, as a list or in ``data`` of a matrix."""
    entry = next((values[name] for name in names if values.get(name) is not None), [])
    entry = entry.get("data", []) if isinstance(entry, Mapping) else entry
    try:
        numbers = [float(number) for number in entry]
    except (TypeError, ValueError):
        raise ConfigError(path, f"{names[0]} holds what is no number", REMEDY) from None
    if not np.isfinite(numbers).all():
        raise ConfigError(path, f"{names[0]} holds what is not finite", REMEDY)
    return numbers


# --- KITTI ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Calibration:
    """What one calibration file says of the left colour camera; matrices row by row.

    projection: P2 (3,4), rectified camera to image. rectification: R0_rect (3,3).
    camera_to_road: Tr_cam_to_road (3,4), metres; the road plane has y = 0.
    """

    projection: tuple[float, ...]
    rectification: tuple[float, ...]
    camera_to_road: tuple[float, ...]


def read_calibration(path: Path) -> Calibration:
    """Read P2, R0_rect and Tr_cam_to_road from a calibration file; other rows are not used.

    Raises DatasetError, naming the file and the row, when the file is missing or no text,
    a row is missing, has too few or too many values or one that is not a finite number,
    and when the road plane cannot be seen (a singular matrix).
    """
    try:
        lines = read_regular(path).decode().splitlines()
    except FileNotFoundError:
        raise DatasetError(path, "is missing", "give the picture's calibration file") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise DatasetError(path, f"cannot be read: {reason(problem)}", "replace the file") from None
    split = (line.partition(":") for line in lines)
    rows = {name.strip(): values.split() for name, _, values in split}
    matrices = [_kitti_row(path, name, wanted, rows.get(name)) for name, wanted in ROWS.items()]
    calibration = Calibration(*matrices)
    if torch.linalg.matrix_rank(_to_four(calibration.camera_to_road, 4)) < 4:
        raise DatasetError(path, "Tr_cam_to_road has no inverse", "replace the file")
    plane = road_to_image(calibration)
    if not plane.isfinite().all() or torch.linalg.matrix_rank(plane) < 3:
        raise DatasetError(path, "its matrices show the road as a line", "replace the file")
    return calibration


def _kitti_row(path: Path, name: str, wanted: int, words: list[str] | None) -> tuple[float, ...]:
    """The numbers of a row, all finite; DatasetError for anything else."""
    remedy = f"a row {name}: with {wanted} numbers is needed"
    if words is None:
        raise DatasetError(path, f"has no row {name}", remedy)
    if len(words) != wanted:
        raise DatasetError(path, f"{name} has {len(words)} values", remedy)
    numbers = []
    for word in words:
        try:
            numbers.append(float(word))
        except ValueError:
            numbers.append(math.nan)
        if not math.isfinite(numbers[-1]):
            raise DatasetError(path, f"{name} holds {word!r}", remedy)
    return tuple(numbers)


def road_to_image(calibration: Calibration) -> Tensor:
    """The homography (3,3) float64 from (x, z, 1) to (u, v, 1) up to scale.

    Columns 0, 2 and 3 of P2 · R0_rect · Tr_cam_to_road⁻¹, as the plane has y = 0.
    """
    projection = torch.tensor(calibration.projection, dtype=torch.float64).view(3, 4)
    rectification = _to_four(calibration.rectification, 3)
    road_to_camera = torch.linalg.inv(_to_four(calibration.camera_to_road, 4))
    return (projection @ rectification @ road_to_camera)[:, [0, 2, 3]]


def _to_four(values: tuple[float, ...], columns: int) -> Tensor:
    """A matrix of three rows as (4,4), the rest from the identity."""
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :columns] = torch.tensor(values, dtype=torch.float64).view(3, columns)
    return matrix


def kitti_ground_camera(
    calibration: Calibration, width: int, height: int, mount: tuple[float, float] = (0.0, 0.0)
) -> GroundCamera:
    """The left colour camera of a KITTI calibration over its road plane, for pictures of a size.

    The robot's frame begins below that camera, or such that it stands at ``mount``; KITTI's road
    has x to the right, y down and z ahead, and counts pixels from one. Raises InputError where
    the optical axis misses the picture: it is not of that camera, or cropped.
    """
    projection = np.array(calibration.projection).reshape(3, 4)
    inner = projection[:, :3]
    across, down = float(inner[0, 2]), float(inner[1, 2])  # where the optical axis is, from one
    if not (1 <= across <= width and 1 <= down <= height):
        what = f"is {width}×{height} pixels, the calibration's middle {across:.0f}, {down:.0f}"
        raise InputError("image", what, "give pictures of that camera at their own size")
    camera_to_road = np.array(calibration.camera_to_road).reshape(3, 4)
    rectification = np.array(calibration.rectification).reshape(3, 3)
    turned = camera_to_road[:, :3] @ np.linalg.inv(rectification)  # rectified camera to road
    centre = turned @ -np.linalg.solve(inner, projection[:, 3]) + camera_to_road[:, 3]
    robot = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # road to robot
    lens = Lens(
        width=width,
        height=height,
        focal_x=float(inner[0, 0]),
        focal_y=float(inner[1, 1]),
        centre_x=across - 1,
        centre_y=down - 1,
    )
    # The file's rotations are rounded: their inverse, not their transpose, gives its own points.
    axes = np.linalg.inv(robot @ turned)
    return GroundCamera(lens, pose_of(axes, np.array([*mount, -centre[1]])))
