"""The loop of every command: read, infer, write, remember.

A command chooses the inference and the writers. On images that stand alone workers do all of it,
from reading to writing; on frames of footage they only infer, for frames smooth one another and go
into one video. The results do not depend on who works.
"""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple, Protocol, TypeVar

from torch import Tensor

from roadtorch.base.atomic import make_folder
from roadtorch.base.errors import InputError, RoadtorchError, fault
from roadtorch.base.signals import Stop
from roadtorch.camera.camera import Camera
from roadtorch.detectors.detection import Cues, Detection
from roadtorch.detectors.detector import Detector, Evidence
from roadtorch.inputs.find import open_source
from roadtorch.inputs.item import Item, Selection, Source
from roadtorch.road.steady import Steady
from roadtorch.run.folder import ELSEWHERE
from roadtorch.run.ledger import DONE, DOUBTFUL, Method, Row, failed_row
from roadtorch.run.workers import DIED, Workers

Value = TypeVar("Value")

# --- what is done to items ----------------------------------------------------------------


@dataclass(frozen=True)
class Inference:
    """A detector, for images of one camera where that is known.

    device: where the tensors are while the road is looked for; steps of OpenCV fetch what they
    need.
    """

    detector: Detector
    camera: Camera | None = None
    device: str = "cpu"

    def __call__(self, image: Tensor) -> Detection:
        """Detect the road in an image (3,H,W)."""
        return self.detector.to(self.device).detect(self.checked(image))

    def find(self, image: Tensor) -> Evidence:
        """Do the part of it that needs no other frame."""
        return self.detector.to(self.device).find(self.checked(image))

    def checked(self, image: Tensor) -> Tensor:
        """Return the image on its device; InputError where it is of another camera."""
        if self.camera is not None:
            self.camera.check(image)
        return image.to(self.device)


class Writer(Protocol):
    """Writes detections: into files of each item, or into one that ``close()`` finishes."""

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write one; gives what index.csv says otherwise than usual. InputError on a fault."""
        ...


class FileWriter(Writer, Protocol):
    """Writes files of each item, below ``folder``."""

    @property
    def folder(self) -> Path:
        """The folder of the results."""
        ...

    @property
    def suffixes(self) -> Sequence[str]:
        """How the names of its files end, ``{}`` standing for the names of the cues."""
        ...


@dataclass(frozen=True)
class Task:
    """All that is done to an image that stands alone: read, infer, write."""

    infer: Callable[[Tensor], Detection]
    writer: FileWriter
    method: Method

    def __call__(self, item: Item) -> Row:
        """Return the row of one image; whatever goes wrong inside stays inside."""
        return write_row(item, lambda: self.infer(item.read()), self.writer, self.method)


def write_row(
    item: Item, detect: Callable[[], Detection], writer: FileWriter, method: Method, ms: float = 0
) -> Row:
    """Write the results of an image or a frame and return its row, a failed one on any fault.

    detect: gives the detection, or raises why there is none. ms: what was spent on it before.
    """
    start = perf_counter()
    seconds = "" if item.seconds is None else f"{item.seconds:.3f}"
    try:
        detection = detect()
        if writer.suffixes:
            make_folder((writer.folder / item.name).parent, ELSEWHERE)
        changes = writer.write(item, detection)
        height, width = detection.mask.shape
        row = Row(
            item.row_name,
            str(width),
            str(height),
            elapsed(start, ms),
            road_share=f"{float(detection.mask.double().mean()):.4f}",
            trust="" if detection.trust is None else f"{detection.trust:.2f}",
            status=f"{DOUBTFUL}: {detection.doubt}" if detection.doubt else DONE,
            sha256=item.digest() if item.digest else "",
            seconds=seconds,
        )
        return method.made(replace(row, **changes))
    except Exception as error:  # one that trips a detector must not cost the night's run
        return replace(failed_row(item.row_name, fault(item.origin, error)), seconds=seconds)


def elapsed(start: float, before: float = 0.0) -> str:
    """Return the milliseconds since a moment, and those before it."""
    return f"{before + 1000 * (perf_counter() - start):.0f}"


def crashed_row(item: Item) -> Row:
    """Return the row of an image over which a worker died."""
    return failed_row(item.row_name, InputError(item.origin, *DIED))


# --- frames -------------------------------------------------------------------------------


class FrameResult(NamedTuple):
    """A frame and what was detected in it, or why it has no result.

    ms: from reading to the end of detection.
    """

    item: Item
    outcome: Detection | RoadtorchError
    ms: float

    def detection(self) -> Detection:
        """Return the detection, or raise what went wrong."""
        if isinstance(self.outcome, RoadtorchError):
            raise self.outcome
        return self.outcome


def _timed(where: str, step: Callable[[], Value]) -> tuple[Value | RoadtorchError, float]:
    """Do a step on a frame: its result, or what went wrong, and the milliseconds that it took."""
    start = perf_counter()
    try:
        result = step()
    except Exception as error:  # as in ``write_row``
        result = fault(where, error)
    return result, 1000 * (perf_counter() - start)


@dataclass(frozen=True)
class _Find:
    """What workers do with frames; cues: whether those are wanted in full size, too."""

    inference: Inference
    cues: bool

    def __call__(self, image: Tensor | RoadtorchError) -> tuple[Evidence | RoadtorchError, float]:
        return _timed("image", partial(self._evidence, image))

    def _evidence(self, image: Tensor | RoadtorchError) -> Evidence:
        if isinstance(image, RoadtorchError):
            raise image
        evidence = self.inference.find(image)
        cues = evidence.cues if self.cues else Cues({}, evidence.cues.size)
        return evidence._replace(cues=cues, image=None)


def detections(
    source: Source,
    inference: Inference,
    workers: Workers,
    steady: Steady | None = None,
    cues: bool = True,
    stop: Stop | None = None,
) -> Generator[FrameResult]:
    """Detect the road in every frame of a source, in order.

    cues: whether the detections have them. A frame that cannot be read or looked at has no
    detection, and the others go on. Raises what ``source.items`` raises.
    """
    waiting: deque[tuple[Item, Tensor | RoadtorchError, float]] = deque()

    def images(items: Iterable[Item]) -> Iterator[Tensor | RoadtorchError]:
        for item in items:
            image, ms = _timed(item.origin, item.read)
            waiting.append((item, image, ms))
            yield image

    items = source.items()
    asked = items if stop is None else until_stopped(items, stop, source.live)
    with closing(items) if isinstance(items, Generator) else nullcontext():
        crashed = InputError("image", *DIED), 0.0
        results = workers.map(_Find(inference, cues), images(asked), lambda _: crashed)
        with closing(results):
            for evidence, find_ms in results:
                item, image, read_ms = waiting.popleft()
                step = partial(_conclude, item, image, evidence, inference.detector, steady)
                outcome, ms = _timed(item.origin, step)
                yield FrameResult(item, outcome, read_ms + find_ms + ms)


def _conclude(
    item: Item,
    image: Tensor | RoadtorchError,
    evidence: Evidence | RoadtorchError,
    detector: Detector,
    steady: Steady | None,
) -> Detection:
    """Decide on a frame; the temporal filter sees one frame after the other, in order."""
    if isinstance(evidence, RoadtorchError):
        raise evidence
    assert isinstance(image, Tensor)
    evidence = evidence._replace(image=image)
    if steady is None:
        detection = detector.conclude(evidence)
    else:
        likelihood = steady(image, evidence.likelihood, evidence.ego)
        detection = detector.conclude(evidence, likelihood, steady.hidden)
    return replace(detection, name=item.name, seconds=item.seconds)


def until_stopped(values: Iterable[Value], stop: Stop, live: bool = False) -> Iterator[Value]:
    """Yield values until a stop is requested; do not block on a live source."""
    values = iter(values)
    while not stop.asked:
        stop.at_once = live
        try:
            value = next(values)
        except StopIteration:
            return
        finally:
            stop.at_once = False
        yield value


def detect_stream(
    source: str | os.PathLike[str] | Source,
    detector: Detector,
    selection: Selection = Selection(),  # noqa: B008 - it is frozen
    *,
    steady: Steady | None = None,
    progress: Callable[[int, float | None], None] | None = None,
    failed: Callable[[Item, RoadtorchError], None] | None = None,
) -> Generator[Detection]:
    """Detect the road in frame after frame of a video, camera, stream, bag or folder.

    source: a path, an address or a source of one's own; ``selection`` is for the first two.
    steady: what steadies the likelihood (``roadtorch.road.steady``), made for this source alone.
    progress: told how many frames are done, and their seconds. failed: told of a frame without a
    result, which is then left out; without it, its error is raised. Leaving the loop, closing the
    generator and any error close the source. Raises InputError when the source cannot be opened,
    and behind the last frame when it is cut.

        >>> from roadtorch import detect_stream, load_detector
        >>> for detection in detect_stream("street.jpg", load_detector("prior:rows")):
        ...     print(detection.name, detection)
        street <Detection 320×240, road 50%>
    """
    if not isinstance(source, Source):
        source = open_source(os.fspath(source), selection)
    with closing(detections(source, Inference(detector), Workers(), steady)) as frames:
        for done, frame in enumerate(frames, 1):
            if failed is not None and isinstance(frame.outcome, RoadtorchError):
                failed(frame.item, frame.outcome)
            else:
                yield frame.detection()
            if progress is not None:
                progress(done, frame.item.seconds)
