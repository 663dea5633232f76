"""The loop of every command: read, look, write, remember.

A command chooses what looks and what is written. What stands alone is worked on by workers from
reading to writing; of footage they only look, for its frames steady one another, and go into one
video. The results do not depend on who works.
"""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import NamedTuple, Protocol, TypeVar

from torch import Tensor

from roadtorch.base.atomic import make_folder
from roadtorch.base.errors import InputError, RoadtorchError, fault
from roadtorch.base.signals import Stop
from roadtorch.camera.camera import Camera
from roadtorch.detectors.detector import Detection, Detector, Evidence
from roadtorch.inputs.find import open_source
from roadtorch.inputs.item import Item, Selection, Source
from roadtorch.layout.weights import tensors_hash
from roadtorch.road.steady import Steady
from roadtorch.run.folder import ELSEWHERE
from roadtorch.run.ledger import DONE, DOUBTFUL, Method, Row, failed_row, method_of
from roadtorch.run.memo import file_digests
from roadtorch.run.workers import DIED, Workers

Value = TypeVar("Value")

# --- what is done to items ----------------------------------------------------------------


@dataclass(frozen=True)
class Look:
    """A detector that looks at pictures, of one camera where that is known.

    device: where the tensors are while the road is looked for; steps of OpenCV fetch what they
    need.
    """

    detector: Detector
    camera: Camera | None = None
    device: str = "cpu"

    def __call__(self, image: Tensor) -> Detection:
        """What the detector says of an image (3,H,W)."""
        return self.detector.to(self.device).detect(self.checked(image))

    def find(self, image: Tensor) -> Evidence:
        """The part of it that needs no other frame."""
        return self.detector.to(self.device).find(self.checked(image))

    def checked(self, image: Tensor) -> Tensor:
        """The image on its device; InputError where it is of another camera."""
        if self.camera is not None:
            self.camera.check(image)
        return image.to(self.device)


class Writer(Protocol):
    """What writes detections: into files of each item, or into one that ``close()`` finishes."""

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write one; gives what index.csv says otherwise than ``row_of``. InputError on a fault."""
        ...


class FileWriter(Writer, Protocol):
    """What writes files of each item, below ``folder``."""

    @property
    def folder(self) -> Path:
        """The folder of the results."""
        ...

    @property
    def suffixes(self) -> Sequence[str]:
        """How the names of its files end, ``{}`` standing for the names of the cues."""
        ...


def row_of(name: str, detection: Detection) -> Row:
    """The row of what was written of a detection."""
    height, width = detection.mask.shape
    share = float(detection.mask.double().mean())
    trust = "" if detection.trust is None else f"{detection.trust:.2f}"
    status = f"{DOUBTFUL}: {detection.doubt}" if detection.doubt else DONE
    return Row(name, str(width), str(height), "", f"{share:.4f}", trust, status)


@dataclass(frozen=True)
class Task:
    """All that is done to a picture that stands alone: read, look, write."""

    look: Callable[[Tensor], Detection]
    writer: FileWriter
    method: Method

    def __call__(self, item: Item) -> Row:
        """The row of one picture; whatever goes wrong inside stays inside."""
        start = perf_counter()
        try:
            detection = self.look(item.read())
            make_folder((self.writer.folder / item.name).parent, ELSEWHERE)
            changes = self.writer.write(item, detection)
            row = replace(row_of(item.row_name, detection), ms=elapsed(start), **changes)
            return self.method.made(replace(row, sha256=item.digest() if item.digest else ""))
        except Exception as problem:  # one that trips a detector must not cost the night's run
            return failed_row(item.row_name, fault(item.origin, problem))


def method_of_detector(
    detector: Detector, effective: str, kinds: Iterable[str], *parts: bytes
) -> Method:
    """The method of a detector: settings, weights, and the files that its settings name.

    effective: its settings as TOML. parts: what else decides on the results.
    """
    weights = tensors_hash(detector.state_dict()).encode()
    files = repr(file_digests(detector.settings.model_dump())).encode()
    return method_of(kinds, effective, *parts, files, weights)


def elapsed(start: float, before: float = 0.0) -> str:
    """Milliseconds since a moment, and those before it."""
    return f"{before + 1000 * (perf_counter() - start):.0f}"


def died_over(item: Item) -> Row:
    """The row of a picture over which a worker died."""
    return failed_row(item.row_name, InputError(item.origin, *DIED))


# --- frames -------------------------------------------------------------------------------


class Detected(NamedTuple):
    """A frame that was looked at. ms: from reading to the end of detection."""

    item: Item
    detection: Detection
    ms: float


class Missed(NamedTuple):
    """A frame without a result, and why."""

    item: Item
    problem: RoadtorchError


class _Frame(NamedTuple):
    item: Item
    image: Tensor | RoadtorchError
    ms: float


@dataclass(frozen=True)
class _Find:
    """What workers do with frames; cues: whether those are wanted in full size, too."""

    look: Look
    cues: bool

    def __call__(self, image: Tensor | RoadtorchError) -> tuple[Evidence, float] | RoadtorchError:
        start = perf_counter()
        try:
            if isinstance(image, RoadtorchError):
                return image
            evidence = self.look.find(image)
        except Exception as problem:  # as in ``Task``
            return fault("image", problem)
        maps = evidence.maps if self.cues else evidence.maps.only("likelihood", "ego")
        return evidence._replace(maps=maps, image=None), 1000 * (perf_counter() - start)


def detections(
    source: Source,
    look: Look,
    workers: Workers,
    steady: Steady | None = None,
    cues: bool = True,
    stop: Stop | None = None,
) -> Generator[Detected | Missed]:
    """What is seen in every frame of a source, in order.

    cues: whether the detections have them. A frame that cannot be read or looked at is missed, and
    the others go on. Raises what ``source.items`` raises.
    """
    waiting: deque[_Frame] = deque()

    def images(items: Iterable[Item]) -> Iterator[Tensor | RoadtorchError]:
        for item in items:
            start = perf_counter()
            image = _image_of(item)
            waiting.append(_Frame(item, image, 1000 * (perf_counter() - start)))
            yield image

    items = source.items()
    asked = items if stop is None else until_asked(items, stop, source.live)
    with closing(items) if isinstance(items, Generator) else nullcontext():
        find = _Find(look, cues)
        found = workers.map(find, images(asked), lambda _: InputError("image", *DIED))
        with closing(found):
            for result in found:
                item, image, ms = waiting.popleft()
                if isinstance(result, RoadtorchError) or isinstance(image, RoadtorchError):
                    yield Missed(item, fault(item.origin, result))  # type: ignore[arg-type]
                else:
                    evidence, more = result
                    evidence = evidence._replace(image=image)
                    yield _concluded(item, evidence, look.detector, steady, ms + more)


def _image_of(item: Item) -> Tensor | RoadtorchError:
    try:
        return item.read()
    except Exception as problem:
        return fault(item.origin, problem)


def _concluded(
    item: Item, evidence: Evidence, detector: Detector, steady: Steady | None, ms: float
) -> Detected:
    """The decision on a frame; what steadies it sees one frame after the other, in order."""
    start = perf_counter()
    if steady is None:
        detection = detector.conclude(evidence)
    else:
        maps = evidence.maps
        likelihood = steady(evidence.image, maps["likelihood"], maps.get("ego"))
        detection = detector.conclude(evidence, likelihood, steady.hidden)
    detection = replace(detection, name=item.name, seconds=item.seconds)
    return Detected(item, detection, ms + 1000 * (perf_counter() - start))


def until_asked(values: Iterable[Value], stop: Stop, live: bool = False) -> Iterator[Value]:
    """The values until somebody asks to stop; a live source is not waited for."""
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
    """What a detector says of frame after frame of a video, camera, stream, bag or folder.

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
    with closing(detections(source, Look(detector), Workers(), steady)) as frames:
        for done, frame in enumerate(frames, 1):
            if isinstance(frame, Detected):
                yield frame.detection
            elif failed is None:
                raise frame.problem
            else:
                failed(frame.item, frame.problem)
            if progress is not None:
                progress(done, frame.item.seconds)
