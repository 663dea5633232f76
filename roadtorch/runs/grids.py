"""What ``grid`` writes of pictures and of footage, and how it knows where the camera is."""

import json
import math
import statistics
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.camera.calibration import (
    Calibration,
    kitti_ground_camera,
    lens_of_info,
    read_calibration,
    read_camera_info,
)
from roadtorch.camera.camera import Camera
from roadtorch.camera.gradients import horizon_of
from roadtorch.camera.ground import (
    GroundCamera,
    Lens,
    Pose,
    lens_of_view,
    mounted,
    pitch_of_horizon,
)
from roadtorch.camera.ground_grid import FREE, Grid, GridSettings, ground_grid
from roadtorch.detector import Detection, Detector
from roadtorch.errors import ConfigError, InputError, RoadtorchError, fault
from roadtorch.io.atomic import make_folder
from roadtorch.io.image import tint_mask, to_pixels, write_jpeg, write_npy
from roadtorch.runs.folder import ELSEWHERE
from roadtorch.runs.footage import (
    Write,
    Written,
    bag_ending,
    is_from_bag,
    missed_row,
    stamp_of,
)
from roadtorch.runs.index import Row
from roadtorch.runs.pictures import Job
from roadtorch.runs.results import row_of
from roadtorch.sinks.bags import BagSink
from roadtorch.sinks.grid import map_picture, write_grid
from roadtorch.sources.bags import camera_info
from roadtorch.sources.frame import Source, sampled
from roadtorch.sources.open import Inputs
from roadtorch.stream import Missed, Seen, seen_frames

SUFFIXES = {
    "pgm": ".grid.pgm",
    "yaml": ".grid.yaml",
    "npy": ".grid.npy",
    "likelihood": ".grid.likelihood.npy",
    "picture": ".grid.jpg",
}

UNSURE = 2.0
"""Degrees of spread of a pitch from which a grid is called doubtful."""

MEDIAN_FRAMES = 9
"""Frames whose median is the pitch of a source; ours: a few wrong ones do not move it."""

# --- where the camera is ----------------------------------------------------------------


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

    def pose(self, pitch: float) -> Pose:
        """Where the camera is at so many degrees; ConfigError for what is beyond the limits."""
        if self.height is None:
            remedy = "give the camera's height above the ground in metres, or --calibration"
            raise ConfigError("--height", "is missing", remedy)
        return mounted(self.height, pitch, self.roll, self.mount)


class Pitch(NamedTuple):
    """Degrees, how they are known, and how unsure they are."""

    degrees: float
    told: str
    spread: float = 0.0


@dataclass(frozen=True)
class Placing:
    """How the camera over the ground is found for each picture.

    calibration: KITTI's, which tells all but ``mount``. lens: None for one of ``fov``, and where
    each bag tells its own. horizon: of the camera's file, share of the height. pitch: None where
    the horizon tells it, or else the layout of each picture.
    """

    given: Mounting
    calibration: Calibration | None = None
    lens: Lens | None = None
    horizon: float | None = None
    pitch: Pitch | None = None

    @property
    def lacks_lens(self) -> bool:
        """Whether the lens is for each bag to tell."""
        return self.lens is None and self.calibration is None and self.given.fov is None

    @property
    def asks_pictures(self) -> bool:
        """Whether each picture tells the pitch by its layout."""
        return self.calibration is None and self.horizon is None and self.pitch is None

    def through(self, lens: Lens) -> "Placing":
        """The same through a lens; ConfigError where the horizon is beyond its limits."""
        if self.horizon is not None and self.pitch is None:
            self.given.pose(pitch_of_horizon(lens, self.horizon, self.given.roll))
        return replace(self, lens=lens)

    @property
    def words(self) -> str:
        """What decides on the camera, as a line of comment in the settings' file."""
        if self.calibration is not None:
            said = {"calibration": asdict(self.calibration), "mount": self.given.mount}
        else:
            lens = None if self.lens is None else self.lens.model_dump()
            own = asdict(replace(self.given, camera=None, camera_info=None))
            said = {**own, "horizon": self.horizon, "lens": lens}
        return f"# {json.dumps({name: one for name, one in said.items() if one is not None})}"

    def __call__(self, image: Tensor, detection: Detection) -> tuple[GroundCamera, Pitch]:
        """The camera of a picture (3,H,W); InputError where that does not tell its pitch."""
        height, width = image.shape[-2:]
        if self.calibration is not None:
            camera = kitti_ground_camera(self.calibration, width, height, self.given.mount)
            return camera, Pitch(camera.pose.pitch, "of the calibration")
        if self.lens is None:
            lens = lens_of_view(width, height, self.given.fov or 0.0)
        else:
            lens = self.lens.at(width, height)
        pitch = self.pitch
        if pitch is None and self.horizon is not None:
            degrees = pitch_of_horizon(lens, self.horizon, self.given.roll)
            pitch = Pitch(degrees, f"horizon at row {self.horizon:.3f} of the camera's file")
        pitch = pitch or self._of_layout(lens, image, detection)
        return GroundCamera(lens, self.given.pose(pitch.degrees)), pitch

    def _of_layout(self, lens: Lens, image: Tensor, detection: Detection) -> Pitch:
        layout = detection.cues.get("layout")
        if layout is None or layout.ndim != 3:
            remedy = "give --pitch or --camera, or a detector with a layout, such as fusion"
            raise InputError("image", "has no layout by this detector to tell the pitch", remedy)
        row, spread = horizon_of(image, layout)
        unsure = math.degrees(math.atan(spread * lens.height / lens.focal_y))
        told = f"horizon at row {row:.3f} of the layout, unsure by {unsure:.1f} degrees"
        return Pitch(pitch_of_horizon(lens, row, self.given.roll), told, unsure)


def placing_of(given: Mounting, inputs: Inputs) -> Placing:
    """How the cameras of inputs are found.

    Raises ConfigError for options that are missing,
    contradict one another or lie beyond their limits, and what the files' readers raise.
    """
    ways = {"--fov": given.fov, "--camera-info": given.camera_info}
    ways["--calibration"] = given.calibration
    named = [name for name, value in ways.items() if value is not None]
    remedy = f"give one of {', '.join(ways)}"
    if len(named) > 1:
        raise ConfigError("grid", f"{' and '.join(named)} were given", remedy)
    if given.calibration is not None:
        own = {"--height": given.height, "--pitch": given.pitch, "--roll": given.roll or None}
        for name in (name for name, value in own.items() if value is not None):
            what = "was given beside --calibration, which has it"
            raise ConfigError(name, what, "leave it out")
        return Placing(given, read_calibration(given.calibration))
    if not named and (inputs.pictures or not all(map(is_from_bag, inputs.sources))):
        raise ConfigError("grid", "nothing tells the lens", remedy)
    given.pose(given.pitch or 0.0)
    if given.fov is not None:
        lens_of_view(2, 2, given.fov)
    horizon = None if given.camera is None else Camera.read(given.camera).horizon
    pitch = None if given.pitch is None else Pitch(given.pitch, "as given")
    placing = Placing(given, None, None, horizon, pitch)
    if given.camera_info is None:
        return placing
    return placing.through(read_camera_info(given.camera_info))


# --- pictures ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Gridding:
    """The work on one picture: read, detect, look from above, write.

    kinds: of results, see ``SUFFIXES``. known: the camera that the picture has to be of.
    """

    detector: Detector
    placing: Placing
    settings: GridSettings
    kinds: tuple[str, ...]
    known: Camera | None = None

    @property
    def ends(self) -> list[str]:
        """How the names of its results end."""
        return [SUFFIXES[kind] for kind in self.kinds]

    def __call__(self, job: Job) -> Row:
        """Write the grid of one picture; the row's road share is that of free cells."""
        image = job.picture.read()
        if self.known is not None:
            self.known.check(image)
        return self.write(job.file, image, self.detector.detect(image), job.output)[1]

    def write(
        self, file: str, image: Tensor, detection: Detection, output: Callable[[str], Path]
    ) -> tuple[Grid, Row]:
        """The grid of an image (3,H,W), its files written; the row for index.csv.

        file: as in index.csv. output: what a name ends with → the path. Raises what ``placing``
        and ``ground_grid`` raise.
        """
        camera, pitch = self.placing(image, detection)
        # Regions that the mask dropped are none; the threshold parts what is between pixels, too.
        likelihood, threshold = detection.likelihood, self.settings.threshold
        road = likelihood * (detection.mask | (likelihood < threshold))
        grid = ground_grid(road, camera, self.settings, detection.cues.get("ego"))
        make_folder(output("").parent, ELSEWHERE)
        write_grid(output(""), grid, f"pitch {pitch.degrees:.2f} degrees, {pitch.told}")
        if "likelihood" in self.kinds:
            write_npy(output(SUFFIXES["likelihood"]), grid.likelihood)
        if "picture" in self.kinds:
            write_jpeg(output(SUFFIXES["picture"]), beside(image, detection.mask, grid))
        doubt = f"pitch unsure by {pitch.spread:.1f} degrees" if pitch.spread > UNSURE else ""
        return grid, row_of(file, detection, float((grid.cells == FREE).double().mean()), doubt)


def beside(image: Tensor, mask: Tensor, grid: Grid) -> Tensor:
    """The picture with its road tinted and the grid, x upwards, at its right: (3,h,w) in [0,1]."""
    picture = tint_mask(to_pixels(image), mask.cpu().numpy())
    upright = cv2.rotate(map_picture(grid), cv2.ROTATE_90_COUNTERCLOCKWISE)
    height = picture.shape[0]
    width = max(1, round(upright.shape[1] * height / upright.shape[0]))
    upright = cv2.resize(upright, (width, height), interpolation=cv2.INTER_AREA)
    both = np.hstack([picture, np.repeat(upright[..., None], 3, 2)])
    return torch.from_numpy(both).permute(2, 0, 1) / 255


# --- footage ----------------------------------------------------------------------------


@dataclass(frozen=True)
class FootageGrids:
    """What is written of a source: a grid a frame, of bags also as messages; one pitch for all.

    gridding: the work on a frame. topic: of bags. frame_id: of the robot, in bags of grids.
    """

    gridding: Gridding
    topic: str | None = None
    frame_id: str = "base_link"

    def __call__(self, source: Source) -> Written:
        """What is written of that source."""
        kinds, ends = self.gridding.kinds, list[str]()
        if is_from_bag(source):
            kinds, ends = (*kinds, "bag"), [bag_ending(source, ".grid")]
        return Written(kinds, ends, self.gridding.ends, partial(self._open, source))

    @contextmanager
    def _open(self, source: Source, job: Job) -> Iterator[Write]:
        """The pitch is found first. However the block ends, the bag has the frames until then."""
        gridding = self.gridding
        if gridding.placing.lacks_lens:
            info = camera_info(source.origin, self.topic)
            matrix, bent = info.matrix.ravel().tolist(), info.distortion.tolist()
            size = (info.width, info.height)
            lens = lens_of_info(source.origin, size, matrix, bent, info.model)
            gridding = replace(gridding, placing=gridding.placing.through(lens))
        if source.moving and gridding.placing.asks_pictures:
            gridding = replace(gridding, placing=steadied(gridding, source))
        if not job.ends:
            yield partial(self._write, gridding, None, job)
            return
        sink = BagSink(job.output(job.ends[0]), self.frame_id, gridding.settings.threshold)
        with closing(sink) as bag:
            yield partial(self._write, gridding, bag, job)

    def _write(self, gridding: Gridding, bag: BagSink | None, job: Job, seen: Seen) -> Row:
        frame = seen.frame
        output = partial(job.output, name=frame.name)
        try:
            grid, row = gridding.write(frame.name, seen.image, seen.detection, output)
        except RoadtorchError as problem:
            return missed_row(Missed(frame, fault(frame.origin, problem)))
        if bag is not None:
            cells, (x, y) = grid.cells.cpu().numpy(), grid.origin
            bag.write_grid(cells, grid.resolution, (x, y), stamp_of(frame), self.frame_id)
        return row


def steadied(gridding: Gridding, source: Source) -> Placing:
    """The placing with one pitch for a whole source: the median of what some frames tell.

    Single pictures jitter, and a robot's camera does not. InputError when no frame tells it.
    """
    check = None if gridding.known is None else gridding.known.check
    placed: list[Pitch] = []
    problem: RoadtorchError | None = None
    frames = seen_frames(sampled(source, MEDIAN_FRAMES), gridding.detector, check=check)
    with closing(frames) as seen:
        for one in seen:
            try:
                if isinstance(one, Missed):
                    raise one.problem
                placed.append(gridding.placing(one.image, one.detection)[1])
            except RoadtorchError as own:
                problem = own
    if placed:
        pitches = [one.degrees for one in placed]
        spread = statistics.median(one.spread for one in placed)
        told = f"median of {len(pitches)} frames ({min(pitches):.2f} to {max(pitches):.2f})"
        told += f" by the layout, unsure by {spread:.1f} degrees"
        pitch = Pitch(statistics.median(pitches), told, spread)
        return replace(gridding.placing, pitch=pitch)
    if problem is None:
        return gridding.placing
    raise fault(source.origin, problem)
