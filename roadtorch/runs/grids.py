"""What ``grid`` writes for one picture, and how it knows the camera."""

import json
import math
import statistics
from collections.abc import Callable, Container, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.camera.birds_eye import Calibration, read_calibration
from roadtorch.camera.calibration import kitti_ground_camera, read_camera_info
from roadtorch.camera.camera import Camera
from roadtorch.camera.ground import (
    GroundCamera,
    Lens,
    Pose,
    lens_of_view,
    mounted,
    pitch_of_horizon,
)
from roadtorch.camera.ground_grid import FREE, Grid, GridSettings, ground_grid
from roadtorch.camera.horizon import horizon_of
from roadtorch.detector import Detection, Detector
from roadtorch.errors import ConfigError, InputError
from roadtorch.io.atomic import make_folder
from roadtorch.io.image import read_image, tint_mask, to_pixels, write_jpeg, write_npy
from roadtorch.runs.batch import Job
from roadtorch.runs.claim import ELSEWHERE
from roadtorch.runs.index import DONE, DOUBTFUL, Row
from roadtorch.sinks.grid import map_picture, write_grid

SUFFIXES = {
    "pgm": ".grid.pgm",
    "yaml": ".grid.yaml",
    "npy": ".grid.npy",
    "likelihood": ".grid.likelihood.npy",
    "picture": ".grid.jpg",
}

UNSURE = 2.0
"""Degrees of spread of a pitch from which a grid is called doubtful."""


@dataclass(frozen=True)
class Mounting:
    """What the user says about the camera: exactly one of the three that tell its lens.

    height: metres. pitch, roll: degrees. mount: x, y on the robot, metres. fov: degrees from side
    to side. camera: what ``roadtorch camera`` wrote, for its horizon.
    """

    height: float | None = None
    pitch: float | None = None
    roll: float = 0.0
    mount: tuple[float, float] = (0.0, 0.0)
    fov: float | None = None
    camera_info: Path | None = None
    calibration: Path | None = None
    camera: Path | None = None


class Placed(NamedTuple):
    """A camera over the ground, how its pitch is known, and how unsure that is in degrees."""

    camera: GroundCamera
    told: str
    spread: float


Placing = Callable[[Tensor, Detection], Placed]


def lens_options(given: Mounting) -> list[str]:
    """The options that were given to tell the lens; ConfigError when they are several."""
    ways = {"--fov": given.fov, "--camera-info": given.camera_info}
    ways["--calibration"] = given.calibration
    named = [name for name, value in ways.items() if value is not None]
    if len(named) > 1:
        raise ConfigError(
            "grid", f"{' and '.join(named)} were given", f"give one of {', '.join(ways)}"
        )
    return named


def placing_of(given: Mounting, found: Lens | None = None) -> tuple[Placing, str]:
    """How a picture's camera is found, and what decides on it, in words for the settings' file.

    found: the lens that a bag tells. Raises ConfigError for options that are missing, contradict
    one another or lie beyond their limits, and what the files' readers raise.
    """
    if not lens_options(given) and found is None:
        remedy = "give one of --fov, --camera-info, --calibration"
        raise ConfigError("grid", "nothing tells the lens", remedy)
    if given.calibration is not None:
        return _kitti_placing(given, given.calibration)
    height = checked_height(given)
    known = found if given.camera_info is None else read_camera_info(given.camera_info)
    if known is None:
        lens_of_view(2, 2, given.fov or 0.0)
    stand = _Stand(given, height, known)
    horizon = _horizon(given)
    if horizon is not None and given.pitch is None and known is not None:
        stand.pose(pitch_of_horizon(known, horizon, given.roll))  # refused now
    if given.pitch is not None or horizon is not None:
        placing = _ToldPitch(stand, partial(_told_pitch, given, horizon or 0.0))
    else:
        placing = PitchOfLayout(stand)
    return placing, _in_words(given, horizon, known)


def checked_height(given: Mounting) -> float:
    """The height; ConfigError where it is missing, or it or the angles are beyond the limits."""
    if given.height is None:
        remedy = "give the camera's height above the ground in metres, or --calibration"
        raise ConfigError("--height", "is missing", remedy)
    mounted(given.height, given.pitch or 0.0, given.roll, given.mount)
    return given.height


def words_of(given: Mounting) -> str:
    """What decides on the camera beside the lens that bags tell, for the settings' file."""
    return _in_words(given, _horizon(given), None)


def _horizon(given: Mounting) -> float | None:
    return None if given.camera is None else Camera.read(given.camera).horizon


def _in_words(given: Mounting, horizon: float | None, known: Lens | None) -> str:
    said = replace(given, camera=None, camera_info=None)
    lens = None if known is None else known.model_dump()
    return _words(**asdict(said), horizon=horizon, lens=lens)


def _kitti_placing(given: Mounting, path: Path) -> tuple[Placing, str]:
    for name, value in (("--height", given.height), ("--pitch", given.pitch)):
        if value is not None:
            raise ConfigError(name, "was given beside --calibration, which has it", "leave it out")
    if given.roll:
        raise ConfigError("--roll", "was given beside --calibration, which has it", "leave it out")
    calibration = read_calibration(path)
    words = _words(calibration=asdict(calibration), mount=given.mount)
    return _KittiPlacing(calibration, given.mount), words


def _words(**values: object) -> str:
    """Values as a line of comment in the settings' file."""
    return f"# {json.dumps({name: each for name, each in values.items() if each is not None})}"


@dataclass(frozen=True)
class _KittiPlacing:
    calibration: Calibration
    mount: tuple[float, float]

    def __call__(self, image: Tensor, _: Detection) -> Placed:
        camera = kitti_ground_camera(self.calibration, image.shape[-1], image.shape[-2], self.mount)
        return Placed(camera, f"pitch {camera.pose.pitch:.2f} degrees, of the calibration", 0.0)


class Pitch(NamedTuple):
    """Degrees, how they are known, and how unsure they are."""

    degrees: float
    told: str
    spread: float = 0.0


@dataclass(frozen=True)
class _Stand:
    """What is known of the camera beside its pitch; lens: None for one of ``--fov``."""

    given: Mounting
    height: float
    lens: Lens | None

    def lens_of(self, image: Tensor) -> Lens:
        height, width = image.shape[-2:]
        fov = self.given.fov or 0.0
        return self.lens.at(width, height) if self.lens else lens_of_view(width, height, fov)

    def pose(self, pitch: float) -> Pose:
        return mounted(self.height, pitch, self.given.roll, self.given.mount)

    def placed(self, lens: Lens, pitch: Pitch) -> Placed:
        told = f"pitch {pitch.degrees:.2f} degrees, {pitch.told}"
        return Placed(GroundCamera(lens, self.pose(pitch.degrees)), told, pitch.spread)


@dataclass(frozen=True)
class _ToldPitch:
    stand: _Stand
    pitch: Callable[[Lens], Pitch]

    def __call__(self, image: Tensor, _: Detection) -> Placed:
        lens = self.stand.lens_of(image)
        return self.stand.placed(lens, self.pitch(lens))


def _told_pitch(given: Mounting, horizon: float, lens: Lens) -> Pitch:
    if given.pitch is not None:
        return Pitch(given.pitch, "as given")
    found = pitch_of_horizon(lens, horizon, given.roll)
    return Pitch(found, f"horizon at row {horizon:.3f} of the camera's file")


@dataclass(frozen=True)
class PitchOfLayout:
    """A camera whose pitch each picture tells by its layout."""

    stand: _Stand

    def __call__(self, image: Tensor, detection: Detection) -> Placed:
        """InputError where the picture does not tell it."""
        layout = detection.cues.get("layout")
        if layout is None or layout.ndim != 3:
            remedy = "give --pitch or --camera, or a detector with a layout, such as fusion"
            raise InputError("image", "has no layout by this detector to tell the pitch", remedy)
        lens = self.stand.lens_of(image)
        row, spread = horizon_of(image, layout)
        degrees = math.degrees(math.atan(spread * lens.height / lens.focal_y))
        told = f"horizon at row {row:.3f} of the layout, unsure by {degrees:.1f} degrees"
        pitch = pitch_of_horizon(lens, row, self.stand.given.roll)
        return self.stand.placed(lens, Pitch(pitch, told, degrees))

    def steadied(self, placed: Sequence[Placed]) -> Placing:
        """The same camera with the median of the pitches that some of its pictures tell."""
        pitches = [one.camera.pose.pitch for one in placed]
        spread = statistics.median(one.spread for one in placed)
        told = f"median of {len(pitches)} frames ({min(pitches):.2f} to {max(pitches):.2f})"
        told += f" by the layout, unsure by {spread:.1f} degrees"
        found = Pitch(statistics.median(pitches), told, spread)
        return _ToldPitch(self.stand, lambda _: found)


class Mapped(NamedTuple):
    """A picture (3,H,W), what was detected in it, its camera, and the grid of both."""

    image: Tensor
    detection: Detection
    placed: Placed
    grid: Grid


def mapped(image: Tensor, detection: Detection, placing: Placing, settings: GridSettings) -> Mapped:
    """A picture and its grid; raises what ``placing`` and ``ground_grid`` raise."""
    placed = placing(image, detection)
    road = decided(detection, settings.threshold)
    grid = ground_grid(road, placed.camera, settings, detection.cues.get("ego"))
    return Mapped(image, detection, placed, grid)


def write_mapped(output: Callable[[str], Path], kinds: Container[str], found: Mapped) -> None:
    """Write a grid's files, see ``SUFFIXES``; output: what a name ends with → the path."""
    make_folder(output("").parent, ELSEWHERE)
    write_grid(output(""), found.grid, found.placed.told)
    if "likelihood" in kinds:
        write_npy(output(SUFFIXES["likelihood"]), found.grid.likelihood)
    if "picture" in kinds:
        pixels = beside(found.image, found.detection.mask, found.grid)
        write_jpeg(output(SUFFIXES["picture"]), pixels)


@dataclass(frozen=True)
class Gridding:
    """The work on one picture: read, detect, look from above, write.

    kinds: of results, see ``SUFFIXES``. known: the camera that the picture has to be of.
    """

    detector: Detector
    placing: Placing
    settings: GridSettings
    kinds: frozenset[str]
    known: Camera | None = None

    def __call__(self, job: Job) -> Row:
        """Write the grid of one picture; the row's road share is that of free cells."""
        start = perf_counter()
        image = read_image(job.picture.path)
        if self.known is not None:
            self.known.check(image)
        found = mapped(image, self.detector.detect(image), self.placing, self.settings)
        write_mapped(job.output, self.kinds, found)
        return grid_row(job.file, found, 1000 * (perf_counter() - start))


def grid_row(file: str, found: Mapped, ms: float) -> Row:
    """The row for index.csv of a grid; the road share is that of free cells. ms: what it took."""
    detection, spread = found.detection, found.placed.spread
    doubt = detection.doubt
    if spread > UNSURE:
        doubt = ", ".join(filter(None, [doubt, f"pitch unsure by {spread:.1f} degrees"]))
    height, width = found.image.shape[-2:]
    share = float((found.grid.cells == FREE).double().mean())
    trust = "" if detection.trust is None else f"{detection.trust:.2f}"
    status = f"{DOUBTFUL}: {doubt}" if doubt else DONE
    return Row(file, str(width), str(height), f"{ms:.0f}", f"{share:.4f}", trust, status)


def decided(detection: Detection, threshold: float) -> Tensor:
    """The likelihood (H,W), 0 where it reaches the threshold but the mask dropped the region.

    Its threshold parts road between pixels where that of the mask parts pixels.
    """
    return detection.likelihood * (detection.mask | (detection.likelihood < threshold))


def beside(image: Tensor, mask: Tensor, grid: Grid) -> Tensor:
    """The picture with its road tinted and the grid, x upwards, at its right: (3,h,w) in [0,1]."""
    picture = tint_mask(to_pixels(image), mask.cpu().numpy())
    upright = cv2.rotate(map_picture(grid), cv2.ROTATE_90_COUNTERCLOCKWISE)
    height = picture.shape[0]
    width = max(1, round(upright.shape[1] * height / upright.shape[0]))
    upright = cv2.resize(upright, (width, height), interpolation=cv2.INTER_AREA)
    both = np.hstack([picture, np.repeat(upright[..., None], 3, 2)])
    return torch.from_numpy(both).permute(2, 0, 1) / 255
