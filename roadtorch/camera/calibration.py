"""Lenses and poses from foreign files: camera_info, OpenCV, Kalibr, and KITTI's calibration."""

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
import torch
from pydantic import AliasChoices, BeforeValidator, Field
from torch import Tensor

from roadtorch.base.bounded import reason
from roadtorch.base.documents import ForeignDocument, describe_validation_error, read_document
from roadtorch.base.errors import ConfigError, DatasetError, InputError
from roadtorch.base.settings import build_settings
from roadtorch.camera.ground import COEFFICIENT_COUNTS, Lens

CAMERA_INFO_HINT = (
    "give a file of camera_calibration, of ros2 topic echo --once on camera_info, of OpenCV's "
    "calibration or of Kalibr"
)

KITTI_ROWS = {"P2": 12, "R0_rect": 9, "Tr_cam_to_road": 12}
"""Rows read from KITTI's files, in the order of ``Calibration``, and the length of each."""

MODEL_ALIASES = {"fisheye": "equidistant", "radtan": "plumb_bob", "none": "", "pinhole": ""}
"""Other names of the distortion models of ``COEFFICIENT_COUNTS``; "": none is named."""

UNNAMED_MODELS = {5: "plumb_bob", 8: "rational_polynomial", 14: "rational_polynomial"}
"""The model by the number of coefficients, where that tells; four may be a fisheye's."""

RECTIFIED_TOPIC = re.compile(r"(^|[/_])rect(ified)?([/_]|$)")
"""Topics of rectified images, as of image_proc: ``image_rect``, ``left_rect/image``."""

MAX_SKEW = 0.5  # pixels by which K may shear the image, which no lens here does
MAX_ROTATION_ERROR = 0.01  # of an element of R Rᵀ; KITTI's rotations are rounded


def _matrix_values(matrix: Any) -> Any:
    """Return the numbers of a matrix as camera_calibration or a message has it, else as it is."""
    values = matrix.get("data") if isinstance(matrix, Mapping) else matrix
    return values if values is None else getattr(values, "tolist", lambda: values)()


_Numbers = Annotated[list[float], BeforeValidator(_matrix_values)]


class _Region(ForeignDocument):
    x_offset: int = 0
    y_offset: int = 0
    width: int = 0
    height: int = 0


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
    fisheye_model: int | bool = False  # of OpenCV's files
    projection: _Numbers = Field(default=[], validation_alias=AliasChoices("p", "P"))
    roi: _Region = _Region()


class _KalibrCamera(ForeignDocument):
    camera_model: Literal["pinhole"]
    intrinsics: tuple[float, float, float, float] = Field(strict=False)
    resolution: tuple[int, int] = Field(strict=False)
    distortion_model: str = "none"
    distortion_coeffs: tuple[float, ...] = Field((), strict=False)

    def camera_info(self) -> _CameraInfo:
        """Return the camera as camera_calibration describes it."""
        (fx, fy, cx, cy), (width, height) = self.intrinsics, self.resolution
        values: dict[str, Any] = {"width": width, "height": height, "d": [*self.distortion_coeffs]}
        values |= {"k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]}
        return _CameraInfo(**values, distortion_model=self.distortion_model)


def read_camera_info(path: str | os.PathLike[str]) -> Lens:
    """Read the lens of a YAML file: camera_calibration's, a printed CameraInfo, OpenCV's, Kalibr's.

    K and D describe the images; R and P are ignored.

    Raises:
        ConfigError, DatasetError: naming the file when it cannot be read or describes no lens.
    """
    path = Path(path)
    with read_document(path, CAMERA_INFO_HINT) as text:
        document = _load_yaml(path, text.decode().removeprefix("%YAML:1.0"))  # OpenCV's, no YAML
        keys = document.keys() if isinstance(document, Mapping) else ()
        cameras = [key for key in keys if re.fullmatch(r"cam\d+", str(key))]
        if len(cameras) > 1:
            raise ConfigError(path, f"has {len(cameras)} cameras", "leave one of them in the file")
        if cameras:
            info = _KalibrCamera.model_validate(document[cameras[0]]).camera_info()
        else:
            info = _CameraInfo.model_validate(document)
    return _build_lens(path, info)


def _load_yaml(path: Path, text: str) -> Any:
    """Return the first document of a YAML text, with OpenCV's matrices and numbers of YAML 1.2."""
    try:
        import yaml
    except ImportError:
        hint = "pip install 'roadtorch[grid]'"
        raise ConfigError(path, "reading YAML needs PyYAML, which is missing", hint) from None

    class Loader(yaml.SafeLoader):
        pass

    number = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$")  # such as 1e-05
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", number, list("-+.0123456789"))
    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", Loader.construct_yaml_map)
    try:
        return next(yaml.load_all(text, Loader), None)
    except yaml.YAMLError as error:
        raise ConfigError(path, f"is not YAML: {reason(error)}", CAMERA_INFO_HINT) from None


def lens_from_camera_info(origin: str, message: Any, topic: str) -> Lens:
    """Return the lens of a CameraInfo message of rosbags or rclpy, for the images on a topic.

    It is K and D, or P where the topic has rectified images, less the region's offset.
    Raises ConfigError naming the origin for an unknown model or number, InputError for an empty K.
    """
    try:
        info = _CameraInfo.model_validate(message, from_attributes=True)
    except pydantic.ValidationError as error:
        problem, hint = f"is not a valid lens: {describe_validation_error(error)}", "calibrate it"
        raise ConfigError(origin, problem, hint) from None
    if not info.matrix[0] > 0:
        raise InputError(origin, "has no calibration", "calibrate the camera, or pass its lens")
    if RECTIFIED_TOPIC.search(topic):
        if info.projection[:1] > [0.0]:
            matrix = [info.projection[4 * row + column] for row in range(3) for column in range(3)]
            update = {"matrix": matrix, "distortion": [], "distortion_model": "pinhole"}
            info = info.model_copy(update=update)
        elif any(info.distortion):
            problem = f"has D but no P, and {topic} has rectified images"
            raise ConfigError(origin, problem, "pass the lens of the rectified images")
    return _build_lens(origin, info)


def _build_lens(path: str | os.PathLike[str], info: _CameraInfo) -> Lens:
    """Return the lens of the images; ConfigError naming the path for what no lens has."""
    focal_x, skew, centre_x, shear, focal_y, centre_y, *last = info.matrix
    width, height, region, problem = info.width, info.height, info.roi, ""
    if not np.allclose([shear, *last], [0, 0, 0, 1], atol=1e-6):
        problem = f"K ends in {', '.join(f'{value:g}' for value in info.matrix[3:])}"
    elif abs(skew) * height > 2 * MAX_SKEW * abs(focal_y):
        problem = f"K has a skew of {skew:g}, which is not modelled"
    elif not (0.05 < centre_x / max(width, 1) < 0.95 and abs(centre_y) < 1.5 * height):
        problem = f"K is centred at {centre_x:g}, {centre_y:g} of {width}×{height} pixels"
    if problem:
        hint = "give K in pixels, of the size that the file states"
        raise ConfigError(path, f"is not a valid lens: {problem}", hint)
    if region.width and region.height:
        width, height = region.width, region.height
        centre_x, centre_y = centre_x - region.x_offset, centre_y - region.y_offset
    names = ("width", "height", "focal_x", "centre_x", "focal_y", "centre_y")
    numbers = (width, height, focal_x, centre_x, focal_y, centre_y)
    values: dict[str, Any] = dict(zip(names, numbers, strict=True))
    model = _distortion_model(path, info)
    if any(info.distortion) or model == "equidistant":  # no pinhole even if all are 0
        values |= {"model": model, "coefficients": tuple(info.distortion)}
    try:
        return build_settings(Lens, values)
    except ConfigError as error:
        problem = f"is not a valid lens: {error.where}: {error.problem}"
        raise ConfigError(path, problem, error.hint) from None


def _distortion_model(path: str | os.PathLike[str], info: _CameraInfo) -> str:
    """Return the distortion model; ConfigError where it is unknown, or missing beside D."""
    name, count = info.distortion_model, len(info.distortion)
    model = MODEL_ALIASES.get(name, name) or ("equidistant" if info.fisheye_model else "")
    if not model:
        model = UNNAMED_MODELS.get(count, "") if any(info.distortion) else "pinhole"
    if model not in COEFFICIENT_COUNTS:
        models = ", ".join(name for name in COEFFICIENT_COUNTS if name != "pinhole")
        problem = f"distortion_model {model!r} is not known"
        if not model:
            problem = f"has {count} distortion coefficients without a distortion_model"
        raise ConfigError(path, problem, f"known: {models}")
    return model


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
    non-finite numbers, or is not that of a camera above the road.
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
    for name, problem in _calibration_problems(calibration):
        raise DatasetError(path, f"{name} {problem}", "replace the file")
    return calibration


def _calibration_problems(calibration: Calibration) -> Iterator[tuple[str, str]]:
    """Yield the rows that are not those of a camera above the road, and what is wrong."""
    projection = np.array(calibration.projection).reshape(3, 4)
    focal_lengths = projection[[0, 1], [0, 1]]
    if not np.allclose(projection[2, :3], (0, 0, 1), atol=1e-6):
        yield "P2", "does not end in 0 0 1 and a shift"
    elif not ((focal_lengths > 0) & (focal_lengths <= 1e6)).all():
        yield "P2", f"has the focal lengths {focal_lengths[0]:g} and {focal_lengths[1]:g}"
    elif abs(projection[1, 0]) > 1e-6:
        yield "P2", f"has the shear {projection[1, 0]:g}"
    matrices = calibration.rectification, calibration.camera_to_road
    for name, values in zip(list(KITTI_ROWS)[1:], matrices, strict=True):
        rotation = np.array(values).reshape(3, -1)[:, :3]
        error = np.abs(rotation @ rotation.T - np.eye(3)).max()
        if error > MAX_ROTATION_ERROR or np.linalg.det(rotation) < 0:
            return (yield name, "is no rotation")
    pose = np.array(calibration.camera_to_road).reshape(3, 4)
    centre = -np.linalg.solve(projection[:, :3], projection[:, 3])
    centre = np.linalg.solve(np.reshape(calibration.rectification, (3, 3)), centre)
    height = -(pose[:, :3] @ centre + pose[:, 3])[1]  # y points down
    if not 0 < height <= 1000:
        yield "Tr_cam_to_road", f"has the camera {height:g} m above the road"


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
