"""Projection between images and flat ground: the lens, and its pose on the robot.

Frames are those of REP 103. Robot: x forward, y left, z up, in metres; the ground is z = 0.
Camera: x right, y down, z along the optical axis. Pixels: (column, row), the centre of the first
pixel is (0, 0), as in OpenCV and in camera_info.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import cv2
import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.settings import Settings

# Degrees. Looking up, too little ground is visible; straight down, no direction is forward.
MIN_PITCH, MAX_PITCH = -30.0, 89.0
MAX_ROLL = 45.0  # degrees
MAX_ASPECT_ERROR = 0.01  # relative difference of aspect ratios, after scaling to whole pixels
MIN_DEPTH = 1e-6  # metres ahead of the lens from which a point is projected
MAX_DISTORTION_ERROR = 0.5  # pixels between a point and its distorted undistortion

COEFFICIENT_COUNTS = {
    "pinhole": (0,),
    "plumb_bob": (4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
"""Numbers of coefficients of each distortion model, as ROS and OpenCV count them."""

_FocalLength = Annotated[float, Field(gt=0, le=1e6)]
_PrincipalPoint = Annotated[float, Field(ge=-1e6, le=1e6)]
_Vector = tuple[float, float, float]


class Lens(Settings):
    """Intrinsics: focal lengths and principal point in pixels, and distortion."""

    width: int = Field(ge=1, description="width of the images in pixels")
    height: int = Field(ge=1, description="height of the images in pixels")
    focal_x: _FocalLength
    focal_y: _FocalLength
    centre_x: _PrincipalPoint
    centre_y: _PrincipalPoint
    model: Literal["pinhole", "plumb_bob", "rational_polynomial", "equidistant"] = "pinhole"
    coefficients: tuple[float, ...] = Field(default=(), strict=False)

    @field_validator("coefficients")
    @classmethod
    def _check_count(cls, values: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        model = info.data.get("model", "pinhole")
        if len(values) not in COEFFICIENT_COUNTS[model]:
            allowed = " or ".join(map(str, COEFFICIENT_COUNTS[model]))
            raise ValueError(f"{model} has {allowed} coefficients")
        return values

    @property
    def matrix(self) -> np.ndarray:
        """Camera matrix, float64, shape (3, 3)."""
        return np.array(
            [[self.focal_x, 0, self.centre_x], [0, self.focal_y, self.centre_y], [0, 0, 1.0]]
        )

    def at(self, width: int, height: int) -> "Lens":
        """Return the lens for images scaled to a size; InputError for another aspect ratio."""
        if abs(width * self.height / (height * self.width) - 1) > MAX_ASPECT_ERROR:
            problem = f"is {width}×{height} pixels, the calibration {self.width}×{self.height}"
            raise InputError("image", problem, "give uncropped images of that aspect ratio")
        scale_x, scale_y = width / self.width, height / self.height
        changes = {
            "width": width,
            "height": height,
            "focal_x": self.focal_x * scale_x,
            "focal_y": self.focal_y * scale_y,
            "centre_x": (self.centre_x + 0.5) * scale_x - 0.5,
            "centre_y": (self.centre_y + 0.5) * scale_y - 0.5,
        }
        return self.model_copy(update=changes)


def pinhole_lens(width: int, height: int, degrees: float) -> Lens:
    """Return a pinhole lens with square pixels and its axis through the image centre.

    Args:
        width: of the images, in pixels.
        height: of the images, in pixels.
        degrees: horizontal field of view, 1 to 170; ConfigError for others.
    """
    if not 1 <= degrees <= 170:
        hint = "give 1 to 170 degrees from side to side"
        raise ConfigError("--fov", f"{degrees:g} degrees were given", hint)
    focal = width / 2 / math.tan(math.radians(degrees) / 2)
    x, y = (width - 1) / 2, (height - 1) / 2
    return Lens(width=width, height=height, focal_x=focal, focal_y=focal, centre_x=x, centre_y=y)


@dataclass(frozen=True)
class Pose:
    """Pose of a camera on the robot.

    Attributes:
        axes: the camera's x, y and z axis in the robot's frame, unit vectors.
        position: of the camera in the robot's frame, metres; z is the height above the ground.
    """

    axes: tuple[_Vector, _Vector, _Vector]
    position: _Vector

    @property
    def pitch(self) -> float:
        """Degrees by which the optical axis points below the horizon."""
        return math.degrees(math.asin(max(-1.0, min(1.0, -self.axes[2][2]))))


def camera_pose(
    height: float, pitch: float, roll: float = 0.0, mount: tuple[float, float] = (0.0, 0.0)
) -> Pose:
    """Return the pose of a camera that looks ahead.

    Args:
        height: metres above the ground.
        pitch: degrees, positive looks down.
        roll: degrees, positive has the camera's right side lower (REP 103).
        mount: x, y of the camera on the robot, metres.

    Raises:
        ConfigError: for values beyond the limits.
    """
    for option, value, low, high, unit in (
        ("--height", height, 0.01, 1000, "metres"),
        ("--pitch", pitch, MIN_PITCH, MAX_PITCH, "degrees; positive looks down"),
        ("--roll", roll, -MAX_ROLL, MAX_ROLL, "degrees"),
    ):
        if not low <= value <= high:
            raise ConfigError(option, f"{value:g} was given", f"give {low:g} to {high:g} {unit}")
    sine, cosine = math.sin(math.radians(pitch)), math.cos(math.radians(pitch))
    right, down = np.array([0.0, -1.0, 0.0]), np.array([-sine, 0.0, -cosine])
    turn, level = math.sin(math.radians(roll)), math.cos(math.radians(roll))
    axes = (level * right + turn * down, level * down - turn * right, (cosine, 0.0, -sine))
    return make_pose(np.array(axes), np.array([*mount, height]))


def make_pose(axes: np.ndarray, position: np.ndarray) -> Pose:
    """Return the pose with axes (3, 3), one per row, and position (3,), as in ``Pose``."""
    x, y, z, origin = (tuple(row) for row in [*axes.tolist(), position.tolist()])
    return Pose((x, y, z), origin)


@dataclass(frozen=True)
class GroundCamera:
    """A camera over flat ground: its lens and its pose."""

    lens: Lens
    pose: Pose

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project points (n, 3), metres in the robot's frame, into the image.

        Returns:
            Pixels, float64, shape (n, 2), and a mask, bool, shape (n,), of the visible ones: false
            behind the camera, outside the image, and where the distortion is not invertible.
        """
        rays = (points - self.pose.position) @ np.array(self.pose.axes).T
        ahead = rays[:, 2] > MIN_DEPTH
        rays = np.where(ahead[:, None], rays, (0.0, 0.0, 1.0))
        pixels = distort_points(self.lens, rays[:, :2] / rays[:, 2:])
        inside = (pixels >= -0.5).all(1) & (pixels[:, 0] < self.lens.width - 0.5)
        inside &= (pixels[:, 1] < self.lens.height - 0.5) & ahead
        if self.lens.coefficients and inside.any():
            undistorted = undistort_points(self.lens, pixels[inside])
            errors = np.abs(undistorted - rays[inside, :2] / rays[inside, 2:]).max(1)
            inside[inside] = errors * self.lens.focal_x < MAX_DISTORTION_ERROR
        return pixels, inside

    def unproject(self, pixels: np.ndarray) -> np.ndarray:
        """Return the directions (n, 3) of pixels (n, 2) in the robot's frame, not normalised."""
        plane = undistort_points(self.lens, pixels)
        return np.column_stack([plane, np.ones(len(plane))]) @ np.array(self.pose.axes)


def distort_points(lens: Lens, plane: np.ndarray) -> np.ndarray:
    """Return the pixels (n, 2) of points (n, 2) on the plane one metre ahead (OpenCV's models)."""
    if not lens.coefficients:
        return plane * (lens.focal_x, lens.focal_y) + (lens.centre_x, lens.centre_y)
    zeros, coefficients = np.zeros(3), np.array(lens.coefficients)
    points = np.column_stack([plane, np.ones(len(plane))])[:, None]
    if lens.model == "equidistant":
        return cv2.fisheye.projectPoints(points, zeros, zeros, lens.matrix, coefficients)[0][:, 0]
    return cv2.projectPoints(points, zeros, zeros, lens.matrix, coefficients)[0][:, 0]


def undistort_points(lens: Lens, pixels: np.ndarray) -> np.ndarray:
    """Return the points (n, 2) of pixels (n, 2) on the plane one metre ahead of the lens."""
    if not lens.coefficients:
        return (pixels - (lens.centre_x, lens.centre_y)) / (lens.focal_x, lens.focal_y)
    coefficients, criteria = np.array(lens.coefficients), (3, 50, 1e-9)  # 3: count and precision
    points = np.ascontiguousarray(pixels, np.float64)[:, None]
    undistort = cv2.fisheye.undistortPoints if lens.model == "equidistant" else cv2.undistortPoints
    return undistort(points, lens.matrix, coefficients, criteria=criteria)[:, 0]


def pitch_from_horizon(lens: Lens, horizon: float, roll: float = 0.0) -> float:
    """Return the pitch in degrees at which the horizon crosses the principal column in a row.

    horizon: fraction of the height from the top; roll in degrees. Raises ConfigError for a row
    outside the image.
    """
    if not 0 <= horizon <= 1:
        hint = "give a fraction of the height, 0 to 1, or --pitch"
        raise ConfigError("horizon", f"{horizon:g} lies outside the image", hint)
    row = horizon * lens.height - 0.5
    slope = undistort_points(lens, np.array([[lens.centre_x, row]]))[0, 1]
    return math.degrees(math.atan(-float(slope) * math.cos(math.radians(roll))))
