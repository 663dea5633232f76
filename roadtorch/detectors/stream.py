"""Frames of footage in order: read, detect, smooth over time."""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

from torch import Tensor

from roadtorch.base.errors import ConfigError, RoadtorchError, to_input_error
from roadtorch.base.signals import StopRequest, until_stopped
from roadtorch.detectors.detection import Cues, Detection
from roadtorch.detectors.mask import Evidence
from roadtorch.imaging.motion import flow_image
from roadtorch.inputs.find import open_source
from roadtorch.inputs.item import Item, Selection, Source
from roadtorch.road.temporal_filter import TemporalFilter, TemporalFilterSettings, estimate_motion

_Value = TypeVar("_Value")
_Result = TypeVar("_Result")
_Image = Tensor | RoadtorchError
_Frame = tuple[_Image, _Image | None, _Image | None]


@runtime_checkable
class FrameDetector(Protocol):
    """A detector in two halves: evidence of each frame, then masks in the order of the frames."""

    def find_evidence(self, image: Tensor) -> Evidence:
        """Compute likelihood and cues of an image (3, H, W), which need no other frame."""
        ...

    def conclude(
        self, evidence: Evidence, temporal_filter: TemporalFilter | None = None
    ) -> Detection:
        """Decide on the mask, after temporal smoothing."""
        ...


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


def _time_step(where: str, step: Callable[[], _Value]) -> tuple[_Value | RoadtorchError, float]:
    """Run a step on a frame; return its result or error, and the milliseconds it took."""
    start = perf_counter()
    try:
        result = step()
    except Exception as error:  # one frame that breaks a detector must not end a long run
        result = to_input_error(where, error)
    return result, 1000 * (perf_counter() - start)


@dataclass(frozen=True)
class _EvidenceTask:
    """The work on a frame that needs no other result: its evidence, on the CPU, and its motion.

    Called with image, grey image before it, and of it, or errors. cues: whether to return
    full-size cues. smoothing: what motion is estimated for, if anything.
    """

    detector: FrameDetector
    cues: bool
    smoothing: TemporalFilterSettings | None

    def __call__(self, frame: _Frame) -> tuple[Evidence | RoadtorchError, float]:
        return _time_step("image", partial(self._evidence, *frame))

    def _evidence(self, image: _Image, previous: _Image | None, grey: _Image | None) -> Evidence:
        if isinstance(image, RoadtorchError):
            raise image
        evidence, motion = self.detector.find_evidence(image).cpu(), None
        if self.smoothing and isinstance(previous, Tensor) and isinstance(grey, Tensor):
            is_cut = previous.shape != grey.shape
            motion = None if is_cut else estimate_motion(previous, grey, self.smoothing)
        cues = evidence.cues if self.cues else Cues({}, evidence.cues.size)
        return evidence._replace(cues=cues, image=None, motion=motion)


def map_in_turn(task: Callable[[_Value], _Result], items: Iterable[_Value]) -> Generator[_Result]:
    """Yield the results of a task on items, one after the other, computed in this process."""
    return (task(item) for item in items)


def detect_frames(
    source: Source,
    detector: FrameDetector,
    temporal_filter: TemporalFilter | None = None,
    cues: bool = True,
    stop: StopRequest | None = None,
    map_task: Callable[..., Generator[Any]] = map_in_turn,
) -> Generator[FrameResult]:
    """Yield a result for every frame of a source, in order; raises as ``source.items``.

    A frame that cannot be read or processed has its error as result. temporal_filter: smooths the
    likelihoods; a new one for each source. cues: whether detections contain cues, at full size.
    stop: ends the frames when a stop is requested. map_task: computes the evidence of frames, in
    their order.
    """
    waiting: deque[tuple[Item, Tensor | RoadtorchError, float]] = deque()
    smoothing = None if temporal_filter is None else temporal_filter.settings

    def read_frames(items: Iterable[Item]) -> Iterator[_Frame]:
        grey: _Image | None = None
        for item in items:
            image, ms = _time_step(item.origin, item.read)
            waiting.append((item, image, ms))
            previous, grey = grey, None
            if smoothing and isinstance(image, Tensor):
                grey, _ = _time_step(item.origin, partial(flow_image, image, smoothing.width))
            yield image, previous, grey

    def conclude(
        item: Item, image: Tensor | RoadtorchError, evidence: Evidence | RoadtorchError
    ) -> Detection:
        if isinstance(evidence, RoadtorchError):
            raise evidence
        detection = detector.conclude(evidence._replace(image=image), temporal_filter)
        return replace(detection, name=item.name, seconds=item.seconds)

    items = source.items()
    frames = items if stop is None else until_stopped(items, stop, source.live)
    with closing(items) if isinstance(items, Generator) else nullcontext():
        task = _EvidenceTask(detector, cues, smoothing)
        with closing(map_task(task, read_frames(frames))) as results:
            for evidence, find_ms in results:
                item, image, read_ms = waiting.popleft()
                outcome, ms = _time_step(item.origin, partial(conclude, item, image, evidence))
                yield FrameResult(item, outcome, read_ms + find_ms + ms)


def detect_stream(
    source: str | os.PathLike[str] | Source,
    detector: FrameDetector,
    selection: Selection = Selection(),  # noqa: B008 - it is frozen
    *,
    smoothing: bool | TemporalFilter = True,
) -> Generator[Detection]:
    """Detect the road in each frame of a video, camera, stream, bag or folder of images.

    Leaving the loop, closing the generator and any error close the source.

    Args:
        source: path, address (rtsp://, https://), camera number ("0"), or a source of your own.
        detector: result of ``load_detector``.
        selection: frames to process, unless the source is your own.
        smoothing: whether the likelihoods of footage are smoothed over time, as by ``infer``
            does unless it gets ``--no-smoothing``; or a filter for this source alone.

    Yields:
        A detection for each frame, in order, on the CPU; ``name`` and ``seconds`` tell which.

    Raises:
        InputError: The source cannot be opened, a frame cannot be used, or the source is cut, after
            its last frame.

    >>> from roadtorch import detect_stream, load_detector
    >>> for detection in detect_stream("street.jpg", load_detector("prior:rows")):
    ...     print(detection.name, detection)
    street <Detection 320×240, road 50%>
    """
    if not isinstance(detector, FrameDetector):
        hint = "write detect_stream(source, detector)"
        raise ConfigError("detector", f"is {type(detector).__name__}", hint)
    if not isinstance(source, Source):
        source = open_source(os.fspath(source), selection)
    temporal_filter = smoothing if isinstance(smoothing, TemporalFilter) else None
    if smoothing is True and source.footage:
        temporal_filter = TemporalFilter(TemporalFilterSettings())
    with closing(detect_frames(source, detector, temporal_filter)) as frames:
        for frame in frames:
            yield frame.detection()
