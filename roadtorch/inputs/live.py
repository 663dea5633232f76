"""Cameras and streams: the newest frame on each read, with reconnection."""

import time
from collections.abc import Callable, Generator
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import Empty, Queue
from threading import Event, Thread

import cv2
from torch import Tensor

from roadtorch.base.decoding import quiet_opencv
from roadtorch.base.errors import InputError
from roadtorch.base.image import from_pixels
from roadtorch.base.urls import without_password
from roadtorch.inputs.item import Item, Selection, Source
from roadtorch.inputs.video import import_av, moving_images, reason_of, upright

Connection = Callable[[], Generator[Callable[[], Tensor]]]
"""Opens a connection and yields functions that read an image; raises InputError when it fails or
ends."""

Newest = tuple[int, float, int, Callable[[], Tensor]]
"""Frame number, clock in seconds, time stamp in nanoseconds, and the function that reads it."""

STREAMS = ("http", "https", "rtsp", "rtsps", "rtmp", "rtmps", "rtp", "srt", "tcp", "udp", "mms")
"""URL schemes that are read as video streams."""

GRACE = 5.0  # seconds beyond the time limit, for what FFmpeg does not interrupt (names looked up)


@dataclass(frozen=True)
class Patience:
    """Timeout and reconnection of a stream."""

    answer: float = 10
    tries: int = 5
    pause: float = 0.5

    @property
    def longest(self) -> float:
        """Seconds until the last reconnection has failed."""
        pauses = self.pause * (2**self.tries - 1)
        return (self.tries + 1) * self.answer + pauses + GRACE


def camera_source(
    number: int,
    selection: Selection,
    patience: Patience = Patience(),
) -> Source:
    """Make a live source of OpenCV's camera of a number."""
    connect = partial(_camera, number)
    return live_source(connect, f"camera-{number}", f"camera:{number}", selection, patience)


def stream_source(
    url: str,
    name: str,
    selection: Selection,
    patience: Patience = Patience(),
) -> Source:
    """Make a live source of a stream's URL (RTSP, HTTP, RTMP, UDP, SRT)."""
    connect = partial(_stream, url, patience)
    return live_source(connect, name, without_password(url), selection, patience)


def live_source(
    connect: Connection, name: str, origin: str, selection: Selection, patience: Patience
) -> Source:
    """Make a live source of a connection, which is reopened when it breaks."""
    newest = partial(newest_frames, connect, name, origin, patience)
    return Source(name, origin, items=lambda: selection.of(newest()), live=True)


def newest_frames(
    connect: Connection, name: str, origin: str, patience: Patience
) -> Generator[Item]:
    """Yield the newest frame on each request; frames between are numbered and dropped.

    A thread reads and keeps one frame. ``seconds`` counts from the first frame, ``stamp`` is the
    time of arrival in nanoseconds since 1970. Raises InputError if the first connection fails, or
    a later one cannot be reopened in time.
    """
    newest: Queue[Newest | InputError] = Queue()
    stop = Event()
    reader = Thread(target=_read, args=(newest, stop, connect, patience), daemon=True)
    reader.start()
    first: float | None = None
    try:
        while True:
            limit = patience.answer * 2 + GRACE if first is None else patience.longest
            try:
                frame = newest.get(timeout=limit)
            except Empty:
                problem = f"gives no frame within {limit:g} seconds"
                raise InputError(origin, problem, "check the stream") from None
            if isinstance(frame, InputError):
                raise frame
            number, clock, stamp, read = frame
            first = clock if first is None else first
            yield Item(
                f"{name}/{number:06d}",
                f"{origin}: frame {number}",
                read,
                number=number,
                seconds=clock - first,
                stamp=stamp,
            )
    finally:
        stop.set()
        reader.join(GRACE)


def _read(
    newest: "Queue[Newest | InputError]", stop: Event, connect: Connection, patience: Patience
) -> None:
    """Keep only the newest frame in the queue and reconnect; end with the error that stopped it."""
    failures, count = 0, 0
    while not stop.is_set():
        try:
            with closing(connect()) as images:
                for image in images:
                    with suppress(Empty):
                        newest.get_nowait()
                    newest.put((count, time.monotonic(), time.time_ns(), image))
                    failures, count = 0, count + 1
                    if stop.is_set():
                        return
        except InputError as error:
            last = error
        except Exception as error:  # a thread's error would be seen by nobody
            last = InputError("stream", f"{type(error).__name__}: {error}", "report it")
        failures += 1
        if not count or failures > patience.tries:
            if count:
                problem = f"{last.problem}; connected to anew {failures - 1} times in vain"
                last = InputError(last.where, problem, "start it again when the stream is back")
            return newest.put(last)
        stop.wait(patience.pause * 2 ** (failures - 1))


# --- connections ------------------------------------------------------------------------


def _stream(url: str, patience: Patience) -> Generator[Callable[[], Tensor]]:
    """Yield the frames of one connection to a stream."""
    av, origin = import_av(), without_password(url)
    options = {"rtsp_transport": "tcp", "fflags": "nobuffer"}
    try:
        with av.open(url, options=options, timeout=patience.answer) as container:
            stream = moving_images(url, container)
            decode = partial(upright, av.video.reformatter.VideoReformatter())
            for frame in container.decode(stream):
                yield partial(decode, frame)
    except (av.FFmpegError, UnicodeError) as error:
        problem = f"cannot be read: {reason_of(error)}"
        if isinstance(error, av.error.ExitError | TimeoutError):
            problem = f"gives no answer within {patience.answer:g} seconds"
        raise InputError(origin, problem, "check the address and the stream") from None
    raise InputError(origin, "has ended", "check the stream")


def _camera(number: int) -> Generator[Callable[[], Tensor]]:
    """Yield the frames of a camera by OpenCV; PyAV's wheels lack FFmpeg's camera input."""
    with quiet_opencv():
        camera = cv2.VideoCapture(number)
    try:
        if not camera.isOpened():
            there = sorted(path.name for path in Path("/dev").glob("video*"))
            hint = f"there are {', '.join(there)}" if there else "no camera is connected"
            raise InputError(f"camera:{number}", "no such camera", hint)
        while True:
            is_read, pixels = camera.read()
            if not is_read:
                raise InputError(f"camera:{number}", "gives no more frames", "connect it again")
            yield partial(from_pixels, pixels[..., ::-1])
    finally:
        camera.release()
