"""Camera over the ground for each image, from settings, camera files and layouts."""

import math
import statistics
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import tomli_w
from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.settings import Settings, build_settings, merge
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
from roadtorch.camera.ground_grid import GridSettings

MEDIAN_FRAMES = 9  # whose median is the pitch of a source, or of the last ones of a live camera
MIN_PITCH_CHANGE = 0.3  # degrees; an estimate is .4 off in the median
GRID_HINT = "give --set {}, or its line below [grid] in the camera file"


class Pitch(NamedTuple):
    """Pitch in degrees, its source, and its standard deviation."""

    degrees: float
    reason: str
    deviation: float = 0.0


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


@dataclass(frozen=True)
class CameraPlacement:
    """Estimator of the camera over the ground for each image."""

    settings: GridSettings
    lens: Lens | None = None  # None if ``fov`` or each bag determines it
    horizon: float | None = None  # of the camera's file, fraction of the height
    pitch: Pitch | None = None  # None if the horizon or each image's layout determines it
    smooth: Callable[[float], float] | None = None  # filter of the estimated pitches

    @property
    def needs_lens(self) -> bool:
        """True if each bag provides the lens."""
        return self.lens is None and self.settings.fov is None

    @property
    def needs_layout(self) -> bool:
        """True if the pitch is estimated from each image's layout."""
        return self.horizon is None and self.pitch is None

    def with_lens(self, lens: Lens) -> "CameraPlacement":
        """Return a copy with a lens; ConfigError if the horizon exceeds the limits of the pitch."""
        if self.horizon is not None and self.pitch is None:
            self._pose(pitch_from_horizon(lens, self.horizon, self.settings.roll))
        return replace(self, lens=lens)

    def as_comment(self) -> str:
        """Return all that determines the grids, as lines of comments for the settings file."""
        lens = None if self.lens is None else self.lens.model_dump(exclude_none=True)
        facts = {"grid": self.settings.model_dump(exclude_none=True)}
        facts |= {"horizon": self.horizon, "lens": lens}
        text = tomli_w.dumps({name: fact for name, fact in facts.items() if fact is not None})
        return "\n".join(f"# {line}".rstrip() for line in text.splitlines())

    def __call__(self, image: Tensor, layout: Tensor | None) -> tuple[GroundCamera, Pitch]:
        """Return camera and pitch for an image (3, H, W); InputError if no horizon is found."""
        height, width = image.shape[-2:]
        if self.lens is None:
            lens = pinhole_lens(width, height, self.settings.fov or 0.0)
        else:
            lens = self.lens.at(width, height)
        pitch = self.pitch
        if pitch is None and self.horizon is not None:
            degrees = pitch_from_horizon(lens, self.horizon, self.settings.roll)
            pitch = Pitch(degrees, f"horizon at row {self.horizon:.3f} of the camera's file")
        pitch = pitch or self._estimate_pitch(lens, image, layout)
        return GroundCamera(lens, self._pose(pitch.degrees)), pitch

    def _pose(self, pitch: float) -> Pose:
        values = self.settings
        return camera_pose(values.height or 0.0, pitch, values.roll, (values.x, values.y))

    def _estimate_pitch(self, lens: Lens, image: Tensor, layout: Tensor | None) -> Pitch:
        if layout is None or layout.ndim != 3:
            hint = "give --set grid.pitch, or --camera, or a detector with a layout, such as fusion"
            problem = "has no layout from this detector to estimate the pitch"
            raise InputError("image", problem, hint)
        row, deviation = estimate_horizon(image, layout)
        deviation = math.degrees(math.atan(deviation * lens.height / lens.focal_y))
        reason = f"horizon at row {row:.3f} of the layout, unsure by {deviation:.1f} degrees"
        degrees = pitch_from_horizon(lens, row, self.settings.roll)
        return Pitch(self.smooth(degrees) if self.smooth else degrees, reason, deviation)


class _Group(Settings):
    """The settings below their key, so that errors name it."""

    grid: GridSettings


def build_placement(
    camera: Camera | None, values: Mapping[str, object], of_bags: bool
) -> CameraPlacement:
    """Return the estimator for all inputs; ConfigError for wrong or missing settings.

    Args:
        camera: gives the lens, the horizon, and the settings that ``values`` lack.
        values: settings of ``GridSettings``, by name.
        of_bags: whether all inputs are bags or topics, which may give the lens.
    """
    recorded = {} if camera is None else camera.grid.model_dump(exclude_unset=True)
    settings = build_settings(_Group, merge({"grid": recorded}, {"grid": values})).grid
    if settings.height is None:
        raise ConfigError("grid.height", "is missing", GRID_HINT.format("grid.height=METRES"))
    lens = camera.lens if camera is not None and settings.fov is None else None
    if lens is None and settings.fov is None and not of_bags:
        hint = GRID_HINT.format("grid.fov=DEGREES") + ", or a --camera with a lens"
        raise ConfigError("grid", "the lens is not specified", hint)
    horizon = None if camera is None else camera.horizon
    pitch = None if settings.pitch is None else Pitch(settings.pitch, "as given")
    placement = CameraPlacement(settings, None, horizon, pitch)
    return placement if lens is None else placement.with_lens(lens)


def median_pitch(pitches: Sequence[Pitch]) -> Pitch:
    """Return one pitch for a whole source: estimates jitter, but a robot's camera does not."""
    degrees = [pitch.degrees for pitch in pitches]
    deviation = statistics.median(pitch.deviation for pitch in pitches)
    reason = f"median of {len(degrees)} frames ({min(degrees):.2f} to {max(degrees):.2f})"
    reason += f" by the layout, unsure by {deviation:.1f} degrees"
    return Pitch(statistics.median(degrees), reason, deviation)
