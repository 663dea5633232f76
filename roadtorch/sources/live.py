"""Cameras and streams: the newest frame whenever one is asked for, and connections that break."""

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from threading import Condition, Thread

import cv2
from pydantic import Field
from torch import Tensor

from roadtorch.errors import InputError
from roadtorch.io.addresses import without_password
from roadtorch.io.decoding import quiet_opencv
from roadtorch.io.image import from_pixels
from roadtorch.settings import Settings
from roadtorch.sources.frame import Frame, Selection, Source
from roadtorch.sources.video import import_av, moving_pictures, reason_of, upright

Picture = Callable[[], Tensor]
Connection = Callable[[], Generator[Picture]]
"""Connects, and gives picture after picture; raises InputError when it cannot, or can no more."""

GRACE = 5.0  # seconds beyond the time limit, for what FFmpeg does not interrupt (names looked up)


class Patience(Settings):
    """How long a stream may be silent, and how often it is connected to anew."""

    answer: float = Field(default=10, gt=0, description="seconds to wait for an answer or a frame")
    tries: int = Field(default=5, ge=0, description="connections anew, one after the other")
    pause: float = Field(default=0.5, ge=0, description="seconds before the first; then doubled")

    @property
    def longest(self) -> float:
        """Seconds until all tries are over."""
        pauses = self.pause * (2**self.tries - 1)
        return (self.tries + 1) * self.answer + pauses + GRACE


def camera_source(number: int, selection: Selection, patience: Patience) -> Source:
    """The camera of that number (OpenCV's) as a live source."""
    connect = partial(_camera, number)
    return live_source(connect, f"camera-{number}", f"camera:{number}", selection, patience)


def stream_source(url: str, name: str, selection: Selection, patience: Patience) -> Source:
    """A stream by its address (RTSP, HTTP, RTMP, UDP, SRT) as a live source."""
    connect = partial(_stream, url, patience)
    return live_source(connect, name, without_password(url), selection, patience)


def live_source(
    connect: Connection, name: str, origin: str, selection: Selection, patience: Patience
) -> Source:
    """The newest frames of a connection, which is made anew when it breaks."""

    def frames() -> Iterator[Frame]:
        with closing(newest_frames(connect, name, origin, patience)) as found:
            yield from selection.of(found)

    return Source(name, origin, moving=True, frames=frames, live=True)


def newest_frames(
    connect: Connection, name: str, origin: str, patience: Patience
) -> Generator[Frame]:
    """The newest frame whenever one is asked for; those between are numbered and dropped.

    ``seconds`` are those since the first frame came, ``stamp`` the nanoseconds since 1970 at which
    a frame came. A thread reads and holds one frame. When the connection breaks it is made anew,
    as often and as slowly as ``patience`` says. Raises InputError when the first connection is
    not made, and when a later one is not made in time.
    """
    box = NewestFrame()
    reader = Thread(target=_read, args=(box, connect, patience), daemon=True, name="roadtorch-live")
    reader.start()
    first: float | None = None
    try:
        while True:
            limit = patience.answer * 2 + GRACE if first is None else patience.longest
            number, clock, stamp, picture = box.take(origin, limit)
            first = clock if first is None else first
            where = f"{origin}: frame {number}"
            yield Frame(number, f"{name}/{number:06d}", where, clock - first, picture, stamp)
    finally:
        box.close()
        reader.join(GRACE)


class NewestFrame:
    """A place for one frame, between the thread that reads and the one that looks."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._held: tuple[int, float, int, Picture] | None = None
        self._problem: InputError | None = None
        self._count = 0
        self.closed = False

    def put(self, picture: Picture) -> None:
        """Replace what is held."""
        with self._changed:
            self._held = (self._count, time.monotonic(), time.time_ns(), picture)
            self._count += 1
            self._changed.notify_all()

    def take(self, origin: str, limit: float) -> tuple[int, float, int, Picture]:
        """Number, clock in seconds, stamp in nanoseconds and picture of the next newest frame.

        Raises what ``fail`` was told, and InputError when nothing comes within ``limit`` seconds.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._held or self._problem, limit)
            held, self._held = self._held, None
            if held is not None:
                return held
            if self._problem is not None:
                raise self._problem
        raise InputError(origin, f"gives no frame within {limit:g} seconds", "check the stream")

    def fail(self, problem: InputError) -> None:
        """Say that no more frame will come."""
        with self._changed:
            self._problem = problem
            self._changed.notify_all()

    def close(self) -> None:
        """Say that no more frame is wanted."""
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    def rest(self, seconds: float) -> None:
        """Wait, until closed at most."""
        with self._changed:
            self._changed.wait_for(lambda: self.closed, seconds)


def _read(box: NewestFrame, connect: Connection, patience: Patience) -> None:
    """Put frame after frame into the box, over connections that break."""
    failures, ever = 0, False
    while not box.closed:
        try:
            with closing(connect()) as pictures:
                for picture in pictures:
                    box.put(picture)
                    failures, ever = 0, True
                    if box.closed:
                        return
        except InputError as problem:
            last = problem
        except Exception as problem:  # a thread's error would be seen by nobody
            last = InputError("stream", f"{type(problem).__name__}: {problem}", "report it")
        failures += 1
        if not ever or failures > patience.tries:
            if ever:
                what = f"{last.what}; connected to anew {failures - 1} times in vain"
                last = InputError(last.where, what, "start it again when the stream is back")
            return box.fail(last)
        box.rest(patience.pause * 2 ** (failures - 1))


# --- connections ------------------------------------------------------------------------


def _stream(url: str, patience: Patience) -> Generator[Picture]:
    """The pictures of one connection to a stream."""
    av, origin = import_av(), without_password(url)
    options = {"rtsp_transport": "tcp", "fflags": "nobuffer"}
    try:
        with av.open(url, options=options, timeout=patience.answer) as container:
            stream = moving_pictures(url, container)
            for picture in container.decode(stream):
                yield partial(upright, picture)
    except (av.FFmpegError, UnicodeError) as problem:
        what = f"cannot be read: {reason_of(problem)}"
        if isinstance(problem, av.error.ExitError | TimeoutError):
            what = f"gives no answer within {patience.answer:g} seconds"
        raise InputError(origin, what, "check the address and the stream") from None
    raise InputError(origin, "has ended", "check the stream")


def _camera(number: int) -> Generator[Picture]:
    """The pictures of a camera; OpenCV, since PyAV's wheels come without FFmpeg's cameras."""
    with quiet_opencv():
        camera = cv2.VideoCapture(number)
    try:
        if not camera.isOpened():
            there = sorted(path.name for path in Path("/dev").glob("video*"))
            remedy = f"there are {', '.join(there)}" if there else "no camera is connected"
            raise InputError(f"camera:{number}", "no such camera", remedy)
        while True:
            is_read, pixels = camera.read()
            if not is_read:
                raise InputError(f"camera:{number}", "gives no more frames", "connect it again")
            yield partial(from_pixels, pixels[..., ::-1])
    finally:
        camera.release()
