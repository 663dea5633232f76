"""The loop of every command: read, infer, write, add a row to index.csv.

A command chooses the inference and the writers. Workers process single images from reading to
writing; of frames they only compute the evidence, for temporal smoothing and videos need all
frames in order. Results do not depend on the number of workers.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Protocol, TypeVar

import numpy as np
from torch import Tensor

from roadtorch.base.atomic import OUT_HINT, make_folder
from roadtorch.base.compute import one_torch_thread
from roadtorch.base.errors import InputError, to_input_error
from roadtorch.camera.camera import Camera
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.detector import Detector
from roadtorch.detectors.mask import Evidence
from roadtorch.inputs.item import Item
from roadtorch.road.temporal_filter import TemporalFilter
from roadtorch.run.ledger import DONE, DOUBTFUL, IndexRow, failed_row
from roadtorch.run.workers import WORKER_CRASH

_Value = TypeVar("_Value")

# --- single images ------------------------------------------------------------------------


@dataclass(frozen=True)
class Inference:
    """A detector, optionally for the images of one camera, as all commands and streams use it.

    The detector analyses images on its device. Evidence and detections are on the CPU, where masks
    are decided, smoothed and written.
    """

    detector: Detector
    camera: Camera | None = None

    @one_torch_thread()
    def __call__(self, image: Tensor) -> Detection:
        """Detect the road in an image (3, H, W)."""
        return self.conclude(self.find_evidence(image))

    def find_evidence(self, image: Tensor) -> Evidence:
        """Compute the evidence of an image, the part of detection that needs no other frame.

        Raises:
            InputError: The image does not fit the camera, or cannot be used.
        """
        if self.camera is not None:
            self.camera.check(image)
        return self.detector.find_evidence(image).cpu()

    def conclude(
        self, evidence: Evidence, temporal_filter: TemporalFilter | None = None
    ) -> Detection:
        """Decide on the mask of an image, after temporal smoothing of a frame."""
        return self.detector.conclude(evidence, temporal_filter)


class Writer(Protocol):
    """A writer of detections, into files of each item or into one that ``close()`` finishes."""

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write a detection, and return columns of index.csv to override; InputError on failure."""
        ...


class FileWriter(Writer, Protocol):
    """A writer of separate files for each item, below ``folder``."""

    @property
    def folder(self) -> Path:
        """Output folder."""
        ...

    @property
    def suffixes(self) -> Sequence[str]:
        """Suffixes of its files; ``{}`` stands for the name of a cue."""
        ...


@dataclass(frozen=True)
class Task:
    """The work on a single image: read, infer, write."""

    infer: Callable[[Tensor], Detection]
    writer: FileWriter
    key: str  # of all but the image that results depend on, see ``cache_key``
    kinds: tuple[str, ...]  # of results that are written
    streams: Sequence[Writer] = ()  # of a whole source, as videos; an error ends the source

    def __call__(self, item: Item) -> IndexRow:
        """Process an image and return its row; an error becomes a failed row."""
        item = item.hold()
        return self.write_row(item, lambda: self.infer(item.read()))

    def write_row(self, item: Item, detect: Callable[[], Detection], ms: float = 0) -> IndexRow:
        """Write the results of an image or frame, and return its row of index.csv.

        detect: returns the detection, or raises: any error makes a failed row. ms: milliseconds
        spent on the item before this call. Raises the errors of streams.
        """
        start, detection = perf_counter(), None
        seconds = "" if item.seconds is None else f"{item.seconds:.3f}"
        try:
            detection = detect()
            if self.writer.suffixes:
                make_subfolder(self.writer.folder, item.name)
            changes = self.writer.write(item, detection)
            height, width = detection.mask.shape
            row = IndexRow(
                item.row_name,
                str(width),
                str(height),
                road_fraction=f"{np.count_nonzero(detection.mask.numpy()) / (width * height):.4f}",
                trust="" if detection.trust is None else f"{detection.trust:.2f}",
                status=f"{DOUBTFUL}: {detection.doubt}" if detection.doubt else DONE,
                saved=" ".join(self.kinds),
                method=self.key,
                sha256=item.digest() if item.digest else "",
                seconds=seconds,
            )
            row = replace(row, **changes)
        except Exception as error:  # one image that breaks a detector must not end a long run
            row = failed_row(item.row_name, to_input_error(item.origin, error))
            row = replace(row, seconds=seconds)
        if detection is not None:
            for writer in self.streams:
                writer.write(item, detection)
        spent = ms + 1000 * (perf_counter() - start)
        return row if row.failed else replace(row, ms=f"{spent:.0f}")


def make_subfolder(folder: Path, name: str) -> None:
    """Make the folder of a result below an output folder; InputError where that is gone."""
    if not folder.is_dir():
        raise InputError(folder, "was moved during the run", "run it again, --out where it is")
    make_folder((folder / name).parent, OUT_HINT)


def crashed_row(item: Item) -> IndexRow:
    """Return the row of an image whose worker process died."""
    return failed_row(item.row_name, InputError(item.origin, *WORKER_CRASH))


def crashed_evidence(_: object) -> tuple[InputError, float]:
    """Return the result of a frame whose worker process died."""
    return InputError("image", *WORKER_CRASH), 0.0


def run_behind(step: Callable[[_Value], object], values: Iterable[_Value]) -> None:
    """Run a step on each value, in order, in a thread that works while the next value is made."""
    with ThreadPoolExecutor(1) as thread:
        running = thread.submit(int)
        try:
            for value in values:
                running.result()
                running = thread.submit(step, value)
        finally:  # an error of the step precedes those of later values
            running.result()
