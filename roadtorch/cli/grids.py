"""What ``grid`` writes for one picture, and how it knows the camera."""

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
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
from roadtorch.camera.ground import GroundCamera, Lens, lens_of_view, mounted, pitch_of_horizon
from roadtorch.camera.ground_grid import FREE, Grid, GridSettings, ground_grid
from roadtorch.camera.horizon import horizon_of
from roadtorch.cli.batch import DONE, DOUBTFUL, Job, Row
from roadtorch.cli.claim import ELSEWHERE
from roadtorch.detector import Detection, Detector
from roadtorch.errors import ConfigError, InputError
from roadtorch.files import make_folder
from roadtorch.image import read_image, tint_mask, to_pixels, write_jpeg, write_npy
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


def placing_of(given: Mounting) -> tuple[Placing, str]:
    """How a picture's camera is found, and what decides on it, in words for the settings' file.

    Raises ConfigError for options that are missing, contradict one another or lie beyond their
    limits, and what the files' readers raise.
    """
    ways = {"--fov": given.fov, "--camera-info": given.camera_info}
    ways["--calibration"] = given.calibration
    named = [name for name, value in ways.items() if value is not None]
    if len(named) != 1:
        what = f"{' and '.join(named)} were given" if named else "nothing tells the lens"
        raise ConfigError("grid", what, f"give one of {', '.join(ways)}")
    if given.calibration is not None:
        return _kitti_placing(given, given.calibration)
    if given.height is None:
        remedy = "give the camera's height above the ground in metres, or --calibration"
        raise ConfigError("--height", "is missing", remedy)
    mounted(given.height, given.pitch or 0.0, given.roll, given.mount)  # refused now
    known = None if given.camera_info is None else read_camera_info(given.camera_info)
    if known is None:
        lens_of_view(2, 2, given.fov or 0.0)
    horizon = None if given.camera is None else Camera.read(given.camera).horizon
    if horizon is not None and given.pitch is None and known is not None:
        _check_pitch(given, known, horizon)
    said = replace(given, camera=None, camera_info=None)
    lens = None if known is None else known.model_dump()
    words = _words(**asdict(said), horizon=horizon, lens=lens)
    return _Placing(given, given.height, known, horizon), words


def _check_pitch(given: Mounting, lens: Lens, horizon: float) -> None:
    mounted(1.0, pitch_of_horizon(lens, horizon, given.roll), given.roll, given.mount)


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


@dataclass(frozen=True)
class _Placing:
    given: Mounting
    height: float
    lens: Lens | None
    horizon: float | None

    def __call__(self, image: Tensor, detection: Detection) -> Placed:
        height, width = image.shape[-2:]
        fov = self.given.fov or 0.0
        lens = self.lens.at(width, height) if self.lens else lens_of_view(width, height, fov)
        pitch, told, spread = self._pitch(lens, image, detection)
        pose = mounted(self.height, pitch, self.given.roll, self.given.mount)
        return Placed(GroundCamera(lens, pose), f"pitch {pitch:.2f} degrees, {told}", spread)

    def _pitch(self, lens: Lens, image: Tensor, detection: Detection) -> tuple[float, str, float]:
        given = self.given
        if given.pitch is not None:
            return given.pitch, "as given", 0.0
        if self.horizon is not None:
            found = pitch_of_horizon(lens, self.horizon, given.roll)
            return found, f"horizon at row {self.horizon:.3f} of the camera's file", 0.0
        layout = detection.cues.get("layout")
        if layout is None or layout.ndim != 3:
            remedy = "give --pitch or --camera, or a detector with a layout, such as fusion"
            raise InputError("image", "has no layout by this detector to tell the pitch", remedy)
        row, spread = horizon_of(image, layout)
        degrees = math.degrees(math.atan(spread * lens.height / lens.focal_y))
        told = f"horizon at row {row:.3f} of the layout, unsure by {degrees:.1f} degrees"
        return pitch_of_horizon(lens, row, given.roll), told, degrees


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
        detection = self.detector.detect(image)
        placed = self.placing(image, detection)
        road = decided(detection, self.settings.threshold)
        grid = ground_grid(road, placed.camera, self.settings, detection.cues.get("ego"))
        make_folder(job.output("").parent, ELSEWHERE)
        write_grid(job.output(""), grid, placed.told)
        if "likelihood" in self.kinds:
            write_npy(job.output(SUFFIXES["likelihood"]), grid.likelihood)
        if "picture" in self.kinds:
            write_jpeg(job.output(SUFFIXES["picture"]), beside(image, detection.mask, grid))
        return _row(job, image, detection, placed, grid, 1000 * (perf_counter() - start))


def _row(
    job: Job, image: Tensor, detection: Detection, placed: Placed, grid: Grid, ms: float
) -> Row:
    doubt = detection.doubt
    if placed.spread > UNSURE:
        doubt = ", ".join(filter(None, [doubt, f"pitch unsure by {placed.spread:.1f} degrees"]))
    height, width = image.shape[-2:]
    share = float((grid.cells == FREE).double().mean())
    trust = "" if detection.trust is None else f"{detection.trust:.2f}"
    status = f"{DOUBTFUL}: {doubt}" if doubt else DONE
    return Row(job.file, str(width), str(height), f"{ms:.0f}", f"{share:.4f}", trust, status)


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
