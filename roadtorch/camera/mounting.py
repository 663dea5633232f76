"""Camera over the ground for each image, from options, files and layouts."""

import json
import math
import statistics
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.camera.calibration import (
    Calibration,
    kitti_ground_camera,
    read_calibration,
    read_camera_info,
)
from roadtorch.camera.camera import Camera
from roadtorch.camera.gradients import estimate_horizon
from roadtorch.camera.ground import (
    GroundCamera,
    Lens,
    Pose,
    camera_pose,
    pinhole_lens,
    pitch_from_horizon,
)

MEDIAN_FRAMES = 9  # whose median is the pitch of a source, or of the last ones of a live camera
MIN_PITCH_CHANGE = 0.3  # degrees; an estimate is .4 off in the median


@dataclass(frozen=True)
class Mounting:
    """Options about the camera, exactly one of ``fov``, ``camera_info`` and ``calibration``."""

    height: float | None = None  # metres
    pitch: float | None = None  # degrees
    roll: float = 0.0  # degrees
    mount: tuple[float, float] = (0.0, 0.0)  # x, y on the robot, metres
    fov: float | None = None  # horizontal field of view, degrees
    camera_info: Path | None = None
    calibration: Path | None = None
    camera: Path | None = None  # file of ``roadtorch camera``, for its horizon

    def pose(self, pitch: float) -> Pose:
        """Return the pose at a pitch in degrees; ConfigError beyond the limits."""
        if self.height is None:
            hint = "give the camera's height above the ground in metres, or --calibration"
            raise ConfigError("--height", "is missing", hint)
        return camera_pose(self.height, pitch, self.roll, self.mount)


class Pitch(NamedTuple):
    """Pitch in degrees, its source, and its standard deviation."""

    degrees: float
    reason: str
    deviation: float = 0.0


@dataclass(frozen=True)
class CameraPlacement:
    """Estimator of the camera over the ground for each image."""

    mounting: Mounting
    calibration: Calibration | None = None  # KITTI's, which determines all but ``mount``
    lens: Lens | None = None  # None if ``fov`` or each bag determines it
    horizon: float | None = None  # of the camera's file, fraction of the height
    pitch: Pitch | None = None  # None if the horizon or each image's layout determines it

    @property
    def needs_lens(self) -> bool:
        """True if each bag provides the lens."""
        return self.lens is None and self.calibration is None and self.mounting.fov is None

    @property
    def needs_layout(self) -> bool:
        """True if the pitch is estimated from each image's layout."""
        return self.calibration is None and self.horizon is None and self.pitch is None

    def with_lens(self, lens: Lens) -> "CameraPlacement":
        """Return a copy with a lens; ConfigError if the horizon exceeds the limits of the pitch."""
        if self.horizon is not None and self.pitch is None:
            self.mounting.pose(pitch_from_horizon(lens, self.horizon, self.mounting.roll))
        return replace(self, lens=lens)

    @property
    def as_comment(self) -> str:
        """The inputs that determine the camera, as a comment line for the settings file."""
        if self.calibration is not None:
            facts = {"calibration": asdict(self.calibration), "mount": self.mounting.mount}
        else:
            lens = None if self.lens is None else self.lens.model_dump(exclude_none=True)
            options = asdict(replace(self.mounting, camera=None, camera_info=None))
            facts = {**options, "horizon": self.horizon, "lens": lens}
        return f"# {json.dumps({name: fact for name, fact in facts.items() if fact is not None})}"

    def __call__(self, image: Tensor, layout: Tensor | None) -> tuple[GroundCamera, Pitch]:
        """Return camera and pitch for an image (3, H, W); InputError if no horizon is found."""
        height, width = image.shape[-2:]
        if self.calibration is not None:
            camera = kitti_ground_camera(self.calibration, width, height, self.mounting.mount)
            return camera, Pitch(camera.pose.pitch, "of the calibration")
        if self.lens is None:
            lens = pinhole_lens(width, height, self.mounting.fov or 0.0)
        else:
            lens = self.lens.at(width, height)
        pitch = self.pitch
        if pitch is None and self.horizon is not None:
            degrees = pitch_from_horizon(lens, self.horizon, self.mounting.roll)
            pitch = Pitch(degrees, f"horizon at row {self.horizon:.3f} of the camera's file")
        pitch = pitch or self._estimate_pitch(lens, image, layout)
        return GroundCamera(lens, self.mounting.pose(pitch.degrees)), pitch

    def _estimate_pitch(self, lens: Lens, image: Tensor, layout: Tensor | None) -> Pitch:
        if layout is None or layout.ndim != 3:
            hint = "give --pitch or --camera, or a detector with a layout, such as fusion"
            problem = "has no layout from this detector to estimate the pitch"
            raise InputError("image", problem, hint)
        row, deviation = estimate_horizon(image, layout)
        deviation = math.degrees(math.atan(deviation * lens.height / lens.focal_y))
        reason = f"horizon at row {row:.3f} of the layout, unsure by {deviation:.1f} degrees"
        return Pitch(pitch_from_horizon(lens, row, self.mounting.roll), reason, deviation)


def build_placement(mounting: Mounting, of_bags: bool) -> CameraPlacement:
    """Return the estimator for all inputs (of_bags: all are bags); ConfigError for bad options."""
    lenses = {"--fov": mounting.fov, "--camera-info": mounting.camera_info}
    lenses["--calibration"] = mounting.calibration
    options = [name for name, value in lenses.items() if value is not None]
    hint = f"give one of {', '.join(lenses)}, or --camera with a lens"
    if len(options) > 1:
        raise ConfigError("grid", f"{' and '.join(options)} were given", hint)
    if mounting.calibration is not None:
        pose = {"--height": mounting.height, "--pitch": mounting.pitch}
        pose["--roll"] = mounting.roll or None
        for name in (name for name, value in pose.items() if value is not None):
            problem = "conflicts with --calibration, which includes it"
            raise ConfigError(name, problem, "leave it out")
        return CameraPlacement(mounting, read_calibration(mounting.calibration))
    camera = None if mounting.camera is None else Camera.read(mounting.camera)
    lens = camera.lens if camera is not None and not options else None
    if lens is None and not options and not of_bags:
        raise ConfigError("grid", "the lens is not specified", hint)
    mounting.pose(mounting.pitch or 0.0)
    if mounting.fov is not None:
        pinhole_lens(2, 2, mounting.fov)
    horizon = None if camera is None else camera.horizon
    pitch = None if mounting.pitch is None else Pitch(mounting.pitch, "as given")
    placement = CameraPlacement(mounting, None, None, horizon, pitch)
    if mounting.camera_info is not None:
        lens = read_camera_info(mounting.camera_info)
    return placement if lens is None else placement.with_lens(lens)


def median_pitch(pitches: Sequence[Pitch]) -> Pitch:
    """Return one pitch for a whole source: estimates jitter, but a robot's camera does not."""
    degrees = [pitch.degrees for pitch in pitches]
    deviation = statistics.median(pitch.deviation for pitch in pitches)
    reason = f"median of {len(degrees)} frames ({min(degrees):.2f} to {max(degrees):.2f})"
    reason += f" by the layout, unsure by {deviation:.1f} degrees"
    return Pitch(statistics.median(degrees), reason, deviation)


class PitchFilter:
    """Pitch of a live camera: the median of the last estimates, held while it changes little.

    Estimates of single images jitter, and a new pitch costs new rays of the grid. Ours.
    """

    def __init__(self) -> None:
        self._estimates = deque[float](maxlen=MEDIAN_FRAMES)
        self._degrees = math.inf

    def __call__(self, degrees: float) -> float:
        """Add the estimate of an image, and return the pitch, degrees."""
        self._estimates.append(degrees)
        median = statistics.median(self._estimates)
        if abs(median - self._degrees) > MIN_PITCH_CHANGE:
            self._degrees = median
        return self._degrees
