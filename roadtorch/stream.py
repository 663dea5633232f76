"""Footage through a detector: frame after frame, while the next ones are being read."""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import partial
from queue import Full, Queue
from threading import Event, Thread
from time import perf_counter
from typing import NamedTuple, Protocol, TypeVar

from torch import Tensor

from roadtorch.detector import Detection, Detector, Found
from roadtorch.errors import RoadtorchError, fault
from roadtorch.runtime.threads import ordered_results
from roadtorch.sources.frame import Frame, Selection, Source
from roadtorch.sources.open import open_source

Item = TypeVar("Item")


class Steadying(Protocol):
    """What steadies the likelihoods of one source, frame by frame (``roadtorch.road.steady``)."""

    @property
    def hidden(self) -> Tensor | None:
        """What the ego car hides, as the frames so far agree: bool (H,W)."""
        ...

    def __call__(self, image: Tensor, likelihood: Tensor, hidden: Tensor | None = None) -> Tensor:
        """The likelihood (H,W) of the next frame (3,H,W), whose own ego car is hidden."""
        ...


AHEAD = 4
"""Frames read, or written, while others are looked at; ours: decoding is uneven."""

PATIENCE = 0.1  # seconds after which a waiting thread looks whether it is still wanted


class Seen(NamedTuple):
    """A frame that was looked at. image: (3,H,W). ms: from reading to the end of detection."""

    frame: Frame
    image: Tensor
    detection: Detection
    ms: float


class Missed(NamedTuple):
    """A frame without a result, and why."""

    frame: Frame
    problem: RoadtorchError


def detect_stream(
    source: str | os.PathLike[str] | Source,
    detector: Detector,
    selection: Selection = Selection(),  # noqa: B008 - it is frozen
    *,
    jobs: int = 1,
    steady: Steadying | None = None,
    progress: Callable[[int, float | None], None] | None = None,
    failed: Callable[[Frame, RoadtorchError], None] | None = None,
) -> Generator[Detection]:
    """What a detector says of frame after frame of a video, camera, stream, bag or folder.

    source: a path, an address or a source of one's own; ``selection`` is for the first two.
    jobs: frames at a time; the results do not depend on it. steady: what steadies the likelihood,
    made for this source alone. progress: told how many frames are done, and their seconds.
    failed: told of a frame without a result, which is then left out; without it, its error is
    raised. Leaving the loop, closing the generator and any error close the source. Raises
    InputError when the source cannot be opened, and behind the last frame when it is cut.

        >>> from roadtorch import detect_stream, load_detector
        >>> for found in detect_stream("street.jpg", load_detector("prior:rows"), jobs=2):
        ...     print(found.name, found)
        street <Detection 320×240, road 50%>
    """
    if not isinstance(source, Source):
        source = open_source(os.fspath(source), selection)
    with closing(seen_frames(source, detector, jobs=jobs, steady=steady)) as seen:
        for done, one in enumerate(seen, 1):
            if isinstance(one, Missed):
                if failed is None:
                    raise one.problem
                failed(one.frame, one.problem)
            else:
                yield one.detection
            if progress is not None:
                progress(done, one.frame.seconds)


def seen_frames(
    source: Source,
    detector: Detector,
    *,
    jobs: int = 1,
    steady: Steadying | None = None,
    check: Callable[[Tensor], None] | None = None,
) -> Generator[Seen | Missed]:
    """Every frame of a source with what the detector says, in order; the loop of all commands.

    check: raises InputError for an image that is not to be looked at. A frame that cannot be read
    or looked at is missed, and the others go on. Raises what ``source.frames`` raises.
    """
    work = partial(_found, detector=detector, check=check)
    with _frames(source) as frames, closing(ordered_results(frames, work, jobs)) as looked:
        for one in looked:
            yield one if isinstance(one, Missed) else _concluded(one, detector, steady)


class _Look(NamedTuple):
    frame: Frame
    image: Tensor
    found: Found
    ms: float


def _found(
    frame: Frame, detector: Detector, check: Callable[[Tensor], None] | None
) -> _Look | Missed:
    """The part of the work on a frame that needs no other frame."""
    start = perf_counter()
    try:
        image = frame.read()
        if check is not None:
            check(image)
        found = detector.find(image)
    except Exception as problem:  # one that trips a detector must not cost the night's run
        return Missed(frame, fault(frame.origin, problem))
    return _Look(frame, image, found, 1000 * (perf_counter() - start))


def _concluded(look: _Look, detector: Detector, steady: Steadying | None) -> Seen:
    """The decision on a frame; what steadies it sees one frame after the other, in order."""
    start = perf_counter()
    frame, image, found, ms = look
    if steady is None:
        detection = detector.conclude(found)
    else:
        steadied = steady(image, found.maps["likelihood"], found.maps.get("ego"))
        detection = detector.conclude(found, steadied, steady.hidden)
    named = replace(detection, name=frame.name, seconds=frame.seconds)
    return Seen(frame, image, named, ms + 1000 * (perf_counter() - start))


# --- side by side -----------------------------------------------------------------------


@contextmanager
def _frames(source: Source) -> Iterator[Iterator[Frame]]:
    """The frames of a source, read ahead unless it is live."""
    frames = source.frames()
    try:
        if source.live:
            yield frames
        else:
            with ahead(frames, AHEAD) as read:
                yield read
    finally:
        if isinstance(frames, Generator):
            frames.close()


@contextmanager
def ahead(items: Iterator[Item], most: int) -> Iterator[Iterator[Item]]:
    """The same items, fetched by a thread, at most so many ahead; it ends with the block.

    What fetching raises is raised where the missing item is asked for.
    """
    box: Queue[tuple[Item] | BaseException | None] = Queue(most)
    unwanted = Event()

    def put(what: tuple[Item] | BaseException | None) -> None:
        while not unwanted.is_set():
            with suppress(Full):
                return box.put(what, timeout=PATIENCE)

    def fetch() -> None:
        try:
            for item in items:
                put((item,))
                if unwanted.is_set():
                    return
            put(None)
        except BaseException as problem:
            put(problem)

    thread = Thread(target=fetch, name="roadtorch-ahead", daemon=True)
    thread.start()
    try:
        yield _taken(box)
    finally:
        unwanted.set()
        thread.join()


def _taken(box: Queue[tuple[Item] | BaseException | None]) -> Iterator[Item]:
    while (what := box.get()) is not None:
        if isinstance(what, BaseException):
            raise what
        yield what[0]


class Behind:
    """Work that a thread of its own does in order, at most so many pieces behind."""

    def __init__(self, most: int) -> None:
        self._pool = ThreadPoolExecutor(1, "roadtorch-behind")
        self._most = most
        self._waiting: deque[Future[None]] = deque()

    def do(self, work: Callable[[], None]) -> None:
        """Have the work done; raises what an earlier piece has raised."""
        while len(self._waiting) >= self._most or (self._waiting and self._waiting[0].done()):
            self._waiting.popleft().result()
        self._waiting.append(self._pool.submit(work))

    def finish(self) -> None:
        """Wait until all is done; raises what the first piece that failed has raised."""
        try:
            while self._waiting:
                self._waiting.popleft().result()
        finally:
            for future in self._waiting:
                future.cancel()
            self._pool.shutdown()
