"""The loop of every command: read, infer, write, add a row to index.csv.

A command chooses the inference and the writers. Workers process single images from reading to
writing; of frames they only compute the evidence, for temporal smoothing and videos need all
frames in order. Results do not depend on the number of workers.
"""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from torch import Tensor

from roadtorch.base.atomic import make_folder
from roadtorch.base.compute import one_torch_thread
from roadtorch.base.errors import ConfigError, InputError, RoadtorchError, to_input_error
from roadtorch.base.signals import StopRequest
from roadtorch.camera.camera import Camera
from roadtorch.detectors.detection import Cues, Detection
from roadtorch.detectors.detector import Detector, Evidence
from roadtorch.imaging.motion import flow_image
from roadtorch.inputs.find import open_source
from roadtorch.inputs.item import Item, Selection, Source
from roadtorch.road.temporal_filter import TemporalFilter, TemporalFilterSettings, estimate_motion
from roadtorch.run.folder import OUT_HINT
from roadtorch.run.ledger import DONE, DOUBTFUL, IndexRow, Method, failed_row
from roadtorch.run.workers import WORKER_CRASH, Workers

Value = TypeVar("Value")
Result = TypeVar("Result")

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
        return self.detector.conclude(self.find_evidence(image))

    def find_evidence(self, image: Tensor) -> Evidence:
        """Compute the evidence of a frame, the part of detection that needs no other frame.

        Raises:
            InputError: The image does not fit the camera, or cannot be used.
        """
        if self.camera is not None:
            self.camera.check(image)
        return self.detector.find_evidence(image).cpu()


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
    method: Method

    def __call__(self, item: Item) -> IndexRow:
        """Process an image and return its row; an error becomes a failed row."""
        item = item.hold()
        return write_row(item, lambda: self.infer(item.read()), self.writer, self.method)


def write_row(
    item: Item, detect: Callable[[], Detection], writer: FileWriter, method: Method, ms: float = 0
) -> IndexRow:
    """Write the results of an image or frame, and return its row of index.csv.

    detect: returns the detection, or raises: any error makes a failed row. ms: milliseconds spent
    on the item before this call.
    """
    start = perf_counter()
    seconds = "" if item.seconds is None else f"{item.seconds:.3f}"
    try:
        detection = detect()
        if writer.suffixes:
            make_subfolder(writer.folder, item.name)
        changes = writer.write(item, detection)
        height, width = detection.mask.shape
        row = IndexRow(
            item.row_name,
            str(width),
            str(height),
            elapsed_ms(start, ms),
            road_share=f"{np.count_nonzero(detection.mask.numpy()) / (width * height):.4f}",
            trust="" if detection.trust is None else f"{detection.trust:.2f}",
            status=f"{DOUBTFUL}: {detection.doubt}" if detection.doubt else DONE,
            sha256=item.digest() if item.digest else "",
            seconds=seconds,
        )
        return method.mark(replace(row, **changes))
    except Exception as error:  # one image that breaks a detector must not end a long run
        row = failed_row(item.row_name, to_input_error(item.origin, error))
        return replace(row, seconds=seconds)


def make_subfolder(folder: Path, name: str) -> None:
    """Make the folder of a result below an output folder; InputError where that is gone."""
    if not folder.is_dir():
        raise InputError(folder, "was moved during the run", "run it again, --out where it is")
    make_folder((folder / name).parent, OUT_HINT)


def elapsed_ms(start: float, ms: float = 0.0) -> str:
    """Format the milliseconds since ``start`` (``perf_counter``), plus ``ms``."""
    return f"{ms + 1000 * (perf_counter() - start):.0f}"


def crashed_row(item: Item) -> IndexRow:
    """Return the row of an image whose worker process died."""
    return failed_row(item.row_name, InputError(item.origin, *WORKER_CRASH))


# --- frames -------------------------------------------------------------------------------


class FrameResult(NamedTuple):
    """A frame with its detection or error; ms: from reading to the end of detection."""

    item: Item
    outcome: Detection | RoadtorchError
    ms: float

    def detection(self) -> Detection:
        """Return the detection, or raise the error."""
        if isinstance(self.outcome, RoadtorchError):
            raise self.outcome
        return self.outcome


def _time_step(where: str, step: Callable[[], Value]) -> tuple[Value | RoadtorchError, float]:
    """Run a step on a frame; return its result or error, and the milliseconds it took."""
    start = perf_counter()
    try:
        result = step()
    except Exception as error:  # as in ``write_row``
        result = to_input_error(where, error)
    return result, 1000 * (perf_counter() - start)


@dataclass(frozen=True)
class _EvidenceTask:
    """The workers' part of the work on a frame: image, grey image before it, and of it, or errors.

    cues: whether to return full-size cues. smoothing: what motion is estimated for, if anything.
    """

    inference: Inference
    cues: bool
    smoothing: TemporalFilterSettings | None

    def __call__(self, frame: tuple[Any, Any, Any]) -> tuple[Evidence | RoadtorchError, float]:
        return _time_step("image", partial(self._evidence, *frame))

    def _evidence(self, image: Any, previous: Any, grey: Any) -> Evidence:
        if isinstance(image, RoadtorchError):
            raise image
        evidence, motion = self.inference.find_evidence(image), None
        is_pair = isinstance(previous, Tensor) and isinstance(grey, Tensor)
        if self.smoothing and is_pair and previous.shape == grey.shape:
            motion = estimate_motion(previous, grey, self.smoothing)
        cues = evidence.cues if self.cues else Cues({}, evidence.cues.size)
        return evidence._replace(cues=cues, image=None, motion=motion)


def detect_frames(
    source: Source,
    inference: Inference,
    workers: Workers,
    temporal_filter: TemporalFilter | None = None,
    cues: bool = True,
    stop: StopRequest | None = None,
) -> Generator[FrameResult]:
    """Yield a result for every frame of a source, in order; raises as ``source.items``.

    A frame that cannot be read or processed has its error as result. workers: compute the evidence
    of several frames in parallel. temporal_filter: smooths the likelihoods; a new one for each
    source. cues: whether detections contain cues, at full size. stop: ends the frames when a stop
    is requested.
    """
    waiting: deque[tuple[Item, Tensor | RoadtorchError, float]] = deque()
    smoothing = None if temporal_filter is None else temporal_filter.settings

    def read_frames(items: Iterable[Item]) -> Iterator[tuple[Any, Any, Any]]:
        grey: Any = None
        for item in items:
            image, ms = _time_step(item.origin, item.read)
            waiting.append((item, image, ms))
            previous, grey = grey, None
            if smoothing and isinstance(image, Tensor):
                grey, _ = _time_step(item.origin, partial(flow_image, image, smoothing.width))
            yield image, previous, grey

    items = source.items()
    frames = items if stop is None else until_stopped(items, stop, source.live)
    with closing(items) if isinstance(items, Generator) else nullcontext():
        crashed = InputError("image", *WORKER_CRASH), 0.0
        task = _EvidenceTask(inference, cues, smoothing)
        results = workers.map(task, read_frames(frames), lambda _: crashed, source.live)
        with closing(results):
            for evidence, find_ms in results:
                item, image, read_ms = waiting.popleft()
                detector = inference.detector
                step = partial(_conclude, item, image, evidence, detector, temporal_filter)
                outcome, ms = _time_step(item.origin, step)
                yield FrameResult(item, outcome, read_ms + find_ms + ms)


def _conclude(
    item: Item,
    image: Tensor | RoadtorchError,
    evidence: Evidence | RoadtorchError,
    detector: Detector,
    temporal_filter: TemporalFilter | None,
) -> Detection:
    """Decide the mask of a frame, after temporal smoothing; called on the frames in order."""
    if isinstance(evidence, RoadtorchError):
        raise evidence
    assert isinstance(image, Tensor)
    detection = detector.conclude(evidence._replace(image=image), temporal_filter)
    return replace(detection, name=item.name, seconds=item.seconds)


def run_behind(step: Callable[[Value], Result], values: Iterable[Value]) -> Iterator[Result]:
    """Yield the results of a step, which runs in a thread while the value after its own is made."""
    error = running = None
    with ThreadPoolExecutor(1) as thread:
        try:
            for value in values:
                if running is not None:
                    yield running.result()
                running = thread.submit(step, value)
        except Exception as raised:  # re-raised after the last result
            error = raised
        if running is not None:
            yield running.result()
        if error is not None:
            raise error


def until_stopped(
    values: Iterable[Value], stop: StopRequest, live: bool = False
) -> Iterator[Value]:
    """Yield values until a stop is requested; do not block on a live source."""
    values = iter(values)
    while not stop.requested:
        stop.raises_at_once = live
        try:
            value = next(values)
        except StopIteration:
            return
        finally:
            stop.raises_at_once = False
        yield value


def detect_stream(
    source: str | os.PathLike[str] | Source,
    detector: Detector,
    selection: Selection = Selection(),  # noqa: B008 - it is frozen
    *,
    steady: bool | TemporalFilter = True,
    progress: Callable[[int, float | None], None] | None = None,
    failed: Callable[[Item, RoadtorchError], None] | None = None,
) -> Generator[Detection]:
    """Detect the road in each frame of a video, camera, stream, bag or folder of images.

    Leaving the loop, closing the generator and any error close the source.

    Args:
        source: path, address (rtsp://, https://), camera number ("0"), or a source of your own.
        detector: result of ``load_detector``.
        selection: frames to process, unless the source is your own.
        steady: whether the likelihoods of footage are smoothed over time, as ``roadtorch infer``
            does unless it gets ``--no-steady``; or the filter that does it, for this source alone.
        progress: called after each frame with the number of frames and the frame's seconds.
        failed: called with each frame that has no result, which is then skipped; without it the
            frame's error is raised.

    Yields:
        A detection for each frame, in order, on the CPU; ``name`` and ``seconds`` tell which.

    Raises:
        InputError: The source cannot be opened; or it is cut, after its last frame.

    >>> from roadtorch import detect_stream, load_detector
    >>> for detection in detect_stream("street.jpg", load_detector("prior:rows")):
    ...     print(detection.name, detection)
    street <Detection 320×240, road 50%>
    """
    if not isinstance(detector, Detector):
        hint = "write detect_stream(source, detector)"
        raise ConfigError("detector", f"is {type(detector).__name__}", hint)
    if not isinstance(source, Source):
        source = open_source(os.fspath(source), selection)
    if isinstance(steady, bool):
        smoothing = TemporalFilter(TemporalFilterSettings()) if steady and source.footage else None
    else:
        smoothing = steady
    with closing(detect_frames(source, Inference(detector), Workers(), smoothing)) as frames:
        for done, frame in enumerate(frames, 1):
            if failed is not None and isinstance(frame.outcome, RoadtorchError):
                failed(frame.item, frame.outcome)
            else:
                yield frame.detection()
            if progress is not None:
                progress(done, frame.item.seconds)
