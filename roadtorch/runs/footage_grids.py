"""What ``grid`` writes of footage: a grid a frame, of bags also as messages; one pitch a source."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter

from torch import Tensor

from roadtorch.camera.calibration import lens_of_info
from roadtorch.camera.ground import Lens
from roadtorch.camera.ground_grid import GridSettings
from roadtorch.detector import Detector
from roadtorch.errors import InputError, RoadtorchError
from roadtorch.runs.bag_results import bag_ending, is_from_bag, stamp_of
from roadtorch.runs.batch import Job, Row
from roadtorch.runs.footage_results import clock_text, missed_row
from roadtorch.runs.grids import (
    Mounting,
    PitchOfLayout,
    Placed,
    Placing,
    checked_height,
    grid_row,
    lens_options,
    mapped,
    placing_of,
    words_of,
    write_mapped,
)
from roadtorch.sinks.bags import BagSink
from roadtorch.sources.bags import camera_info, is_bag
from roadtorch.sources.frame import Source, sampled
from roadtorch.sources.open import Inputs
from roadtorch.stream import Missed, Seen, seen_frames

SOME = 9
"""Frames whose median is the pitch of a source; ours: a few wrong ones do not move it."""


def placing_of_all(given: Mounting, inputs: Inputs) -> tuple[Placing | None, str]:
    """How cameras are found, as ``placing_of``; None where each input is a bag that tells its lens.

    Raises ConfigError as ``placing_of``.
    """
    if lens_options(given) or inputs.pictures or not all(map(is_bag, inputs.sources)):
        return placing_of(given)
    checked_height(given)
    return None, words_of(given)


def lens_of_bag(given: str, topic: str | None) -> Lens:
    """The lens that the camera_info beside a topic tells; raises as ``camera_info``."""
    info = camera_info(given, topic)
    matrix, bent = info.matrix.ravel().tolist(), info.distortion.tolist()
    return lens_of_info(given, (info.width, info.height), matrix, bent, info.model)


def steady_placing(
    placing: Placing, source: Source, detector: Detector, check: Callable[[Tensor], None] | None
) -> Placing:
    """The placing with one pitch for a whole source that moves, where pictures would tell it.

    Single pictures jitter, and a robot's camera does not. InputError when no frame tells it.
    """
    if not (source.moving and isinstance(placing, PitchOfLayout)):
        return placing
    placed: list[Placed] = []
    problem: RoadtorchError | None = None
    with closing(seen_frames(sampled(source, SOME), detector, check=check)) as seen:
        for one in seen:
            try:
                if isinstance(one, Missed):
                    raise one.problem
                placed.append(placing(one.image, one.detection))
            except RoadtorchError as found:
                problem = found
    if placed:
        return placing.steadied(placed)
    if problem is None:
        return placing
    where = source.origin if problem.where == "image" else problem.where
    raise InputError(where, problem.what, problem.remedy)


@dataclass(frozen=True)
class FootageGrids:
    """What is written of a source.

    files: kinds of files for each frame, as in ``roadtorch.runs.grids.SUFFIXES``. placing: None
    where bags tell their lenses, to cameras mounted as ``given``. check: raises InputError for an
    image of another camera. topic: of bags. frame_id: of the robot, in bags of grids.
    """

    detector: Detector
    settings: GridSettings
    files: tuple[str, ...]
    placing: Placing | None
    given: Mounting
    check: Callable[[Tensor], None] | None = None
    topic: str | None = None
    frame_id: str = "base_link"

    def kinds(self, source: Source) -> tuple[str, ...]:
        """What index.csv says was saved."""
        return (*self.files, "bag") if is_from_bag(source) else self.files

    def suffixes(self, source: Source) -> dict[str, str]:
        """How the names of the files of the whole source end, by kind."""
        return {"bag": bag_ending(source, ".grid")} if is_from_bag(source) else {}

    @contextmanager
    def open(self, source: Source, job: Job) -> Iterator[Callable[[Seen], Row]]:
        """What writes the grid of a frame and gives its row; the pitch is found before.

        However the block ends, the bag is finished with the frames that it has.
        """
        placing = self.placing
        if placing is None:
            placing = placing_of(self.given, lens_of_bag(source.origin, self.topic))[0]
        placing = steady_placing(placing, source, self.detector, self.check)
        with ExitStack() as stack:
            bag = None
            if "bag" in job.suffixes:
                path = job.output(job.suffixes["bag"])
                sink = BagSink(path, self.frame_id, self.settings.threshold)
                bag = stack.enter_context(closing(sink))
            yield partial(self._write, placing, bag, job.out)

    def _write(self, placing: Placing, bag: BagSink | None, out: Path, seen: Seen) -> Row:
        start = perf_counter()
        frame = seen.frame
        try:
            found = mapped(seen.image, seen.detection, placing, self.settings)
        except RoadtorchError as problem:
            where = frame.origin if problem.where == "image" else problem.where
            return missed_row(Missed(frame, InputError(where, problem.what, problem.remedy)))
        write_mapped(lambda suffix: out / (frame.name + suffix), self.files, found)
        if bag is not None:
            cells, (x, y) = found.grid.cells.cpu().numpy(), found.grid.origin
            size, stamp = found.grid.resolution, stamp_of(frame)
            bag.write_grid(cells, size, (x, y), stamp, self.frame_id)
        row = grid_row(frame.name, found, seen.ms + 1000 * (perf_counter() - start))
        return replace(row, seconds=clock_text(frame.seconds))
