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
TINY = 1e-12  # keeps quotients of rays along the axis finite
MAX_DISTORTION_ERROR = 0.5  # pixels between a point and its distorted undistortion
MAX_FIELD_OF_VIEW = 190.0  # degrees; no fisheye is wider unless it says so
FISHEYE_ANGLES = 2048  # of the table that inverts the equidistant model, to 1e-3 pixels

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
    coefficients: tuple[float, ...] = Field(default=(), strict=False, description="OpenCV's order")
    field_of_view: float | None = Field(
        default=None,
        gt=0,
        le=MAX_FIELD_OF_VIEW,
        description="diameter of a fisheye's image circle in degrees; black outside",
    )

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

    width, height: of the images, in pixels. degrees: horizontal field of view, 1 to 170;
    ConfigError for others.
    """
    if not 1 <= degrees <= 170:
        hint = "give 1 to 170 degrees from side to side"
        raise ConfigError("grid.fov", f"{degrees:g} degrees were given", hint)
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
        ("grid.height", height, 0.01, 1000, "metres"),
        ("grid.pitch", pitch, MIN_PITCH, MAX_PITCH, "degrees; positive looks down"),
        ("grid.roll", roll, -MAX_ROLL, MAX_ROLL, "degrees"),
    ):
        if not low <= value <= high:
            raise ConfigError(option, f"{value:g} was given", f"give {low:g} to {high:g} {unit}")
    sine, cosine = math.sin(math.radians(pitch)), math.cos(math.radians(pitch))
    right, down = np.array([0.0, -1.0, 0.0]), np.array([-sine, 0.0, -cosine])
    sine_roll, cosine_roll = math.sin(math.radians(roll)), math.cos(math.radians(roll))
    aside = cosine_roll * right + sine_roll * down
    axes = aside, cosine_roll * down - sine_roll * right, (cosine, 0.0, -sine)
    x, y, z = (tuple(axis) for axis in np.array(axes).tolist())
    return Pose((x, y, z), (float(mount[0]), float(mount[1]), float(height)))


@dataclass(frozen=True)
class GroundCamera:
    """A camera over flat ground: its lens and its pose."""

    lens: Lens
    pose: Pose

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project points (n, 3), metres in the robot's frame, into the image.

        Returns:
            Pixels, float64, shape (n, 2), and a mask, bool, shape (n,), of the visible ones, as
            ``project_rays``.
        """
        return project_rays(self.lens, (points - self.pose.position) @ np.array(self.pose.axes).T)

    def unproject(self, pixels: np.ndarray) -> np.ndarray:
        """Return the directions (n, 3) of pixels (n, 2) in the robot's frame, not normalised."""
        return pixel_rays(self.lens, pixels) @ np.array(self.pose.axes)


def project_rays(lens: Lens, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Project rays (n, 3) in the camera's frame into the image (OpenCV's models).

    Returns:
        Pixels, float64, shape (n, 2), and a mask, bool, shape (n,), of the visible ones: false
        behind the camera or outside a fisheye's circle, outside the image, and where the distortion
        is not invertible.
    """
    is_fisheye = lens.model == "equidistant"
    if is_fisheye:
        angles, radii = _fisheye_table(lens)
        across = np.hypot(rays[:, 0], rays[:, 1])
        angle = np.arctan2(across, rays[:, 2])
        radius = np.interp(angle, angles, radii) / np.maximum(across, TINY)
        plane, visible = rays[:, :2] * radius[:, None], angle <= angles[-1]
    else:
        visible = rays[:, 2] > MIN_DEPTH
        rays = np.where(visible[:, None], rays, (0.0, 0.0, 1.0))
        plane = rays[:, :2] / rays[:, 2:]
    pixels = plane * (lens.focal_x, lens.focal_y) + (lens.centre_x, lens.centre_y)
    if lens.coefficients and not is_fisheye:
        points = np.column_stack([plane, np.ones(len(plane))])[:, None]
        zeros, coefficients = np.zeros(3), np.array(lens.coefficients)
        pixels = cv2.projectPoints(points, zeros, zeros, lens.matrix, coefficients)[0][:, 0]
    visible &= (pixels >= -0.5).all(1) & (pixels[:, 0] < lens.width - 0.5)
    visible &= pixels[:, 1] < lens.height - 0.5
    if lens.coefficients and not is_fisheye and visible.any():
        errors = np.abs(pixel_rays(lens, pixels[visible])[:, :2] - plane[visible]).max(1)
        visible[visible] = errors * lens.focal_x < MAX_DISTORTION_ERROR
    return pixels, visible


def pixel_rays(lens: Lens, pixels: np.ndarray) -> np.ndarray:
    """Return the rays (n, 3) of pixels (n, 2) in the camera's frame, not normalised.

    Of pixels outside a fisheye's circle they are those of its border.
    """
    plane = (pixels - (lens.centre_x, lens.centre_y)) / (lens.focal_x, lens.focal_y)
    if lens.model == "equidistant":
        angles, radii = _fisheye_table(lens)
        radius = np.hypot(plane[:, 0], plane[:, 1])
        angle = np.interp(radius, radii, angles)
        plane = plane * (np.sin(angle) / np.maximum(radius, TINY))[:, None]
        return np.column_stack([plane, np.cos(angle)])
    if lens.coefficients:
        points, criteria = np.ascontiguousarray(pixels, np.float64)[:, None], (3, 50, 1e-9)
        coefficients = np.array(lens.coefficients)
        plane = cv2.undistortPoints(points, lens.matrix, coefficients, criteria=criteria)[:, 0]
    return np.column_stack([plane, np.ones(len(plane))])


def visible_rays(lens: Lens, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rays (n, 3) of pixels (n, 2), and which of them the lens sees, bool (n,)."""
    rays = pixel_rays(lens, pixels)
    projected, visible = project_rays(lens, rays)
    return rays, visible & (np.abs(projected - pixels).max(1) < MAX_DISTORTION_ERROR)


def _fisheye_table(lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Return angles from the axis, radians, and their radii over the focal length, both rising.

    Radius θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸): Kannala and Brandt, IEEE PAMI 28(8), 2006.
    """
    half = math.radians((lens.field_of_view or MAX_FIELD_OF_VIEW) / 2)
    angles = np.linspace(0, half, FISHEYE_ANGLES)
    powers = angles[:, None] ** (2 * np.arange(1, len(lens.coefficients) + 1))
    radii = angles * (1 + powers @ np.array(lens.coefficients))
    rising = int(np.argmax(np.append(np.diff(radii) <= 0, True))) + 1
    return angles[:rising], radii[:rising]


def pitch_from_horizon(lens: Lens, horizon: float, roll: float = 0.0) -> float:
    """Return the pitch in degrees at which the horizon crosses the principal column in a row.

    horizon: fraction of the height from the top; roll in degrees. Raises ConfigError for a row
    outside the image.
    """
    if not 0 <= horizon <= 1:
        hint = "give a fraction of the height, 0 to 1, or grid.pitch"
        raise ConfigError("horizon", f"{horizon:g} lies outside the image", hint)
    row = horizon * lens.height - 0.5
    _, down, ahead = pixel_rays(lens, np.array([[lens.centre_x, row]]))[0].tolist()
    return math.degrees(math.atan2(-down * math.cos(math.radians(roll)), ahead))
