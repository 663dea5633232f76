"""Cameras and streams: the newest frame on each read, with reconnection."""

import time
from collections.abc import Callable, Generator
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from queue import Empty, Queue
from threading import Event, Thread

import cv2
from torch import Tensor

from roadtorch.base.bounded import strip_password
from roadtorch.base.decoding import silence_opencv
from roadtorch.base.errors import InputError
from roadtorch.base.image import from_pixels
from roadtorch.base.urls import encode_url
from roadtorch.inputs.item import Item, Selection, Source
from roadtorch.inputs.video import ffmpeg_reason, frame_decoder, import_av, main_video_stream

Connection = Callable[[], Generator[Callable[[], Tensor]]]
"""Opens a connection and yields functions that read an image; InputError when it is over."""

NewestFrame = tuple[int, float, int, Callable[[], Tensor]]
"""Frame number, clock in seconds, time stamp in nanoseconds, and the function that reads it."""

STREAMS = ("http", "https", "rtsp", "rtsps", "rtmp", "rtmps", "rtp", "srt", "tcp", "udp", "mms")
"""URL schemes that are read as video streams."""

GRACE_PERIOD = 5.0  # seconds beyond a timeout, as FFmpeg does not interrupt DNS lookups


TIMEOUT = 10.0  # seconds to wait for an answer or a frame
RETRIES, BACKOFF = 5, 0.5  # reconnections in a row; seconds before the first, then doubled


def camera_source(number: int, selection: Selection) -> Source:
    """Make a live source of OpenCV's camera of a number."""
    connect = partial(_read_camera, number)
    return live_source(connect, f"camera-{number}", f"camera:{number}", selection)


def stream_source(url: str, name: str, selection: Selection) -> Source:
    """Make a live source of a stream's URL (RTSP, HTTP, RTMP, UDP, SRT)."""
    return live_source(partial(_read_stream, url), name, strip_password(url), selection)


def live_source(connect: Connection, name: str, origin: str, selection: Selection) -> Source:
    """Make a live source of a connection, which is reopened when it breaks."""
    newest = partial(newest_frames, connect, name, origin)
    return Source(name, origin, items=lambda: selection.select(newest()), live=True)


def newest_frames(connect: Connection, name: str, origin: str) -> Generator[Item]:
    """Yield the newest frame on each request; frames between are numbered and dropped.

    A thread reads and keeps one frame. ``seconds`` counts from the first frame, ``stamp`` is the
    time of arrival in nanoseconds since 1970. Raises InputError if the first connection fails, or
    a later one cannot be reopened in time.
    """
    newest: Queue[NewestFrame | InputError] = Queue()
    stop = Event()
    reader = Thread(target=_fill_queue, args=(newest, stop, connect), daemon=True)
    reader.start()
    first: float | None = None
    # Until the last reconnection has failed: each may wait for an answer and for a frame.
    longest = 2 * (RETRIES + 1) * TIMEOUT + BACKOFF * (2**RETRIES - 1) + GRACE_PERIOD
    try:
        while True:
            limit = TIMEOUT * 2 + GRACE_PERIOD if first is None else longest
            try:
                frame = newest.get(timeout=limit)
            except Empty:
                problem = f"gives no frame within {limit:g} seconds"
                raise InputError(origin, problem, "check the stream") from None
            if isinstance(frame, InputError):
                raise frame
            number, clock, stamp, read = frame
            first = clock if first is None else first
            label, where = f"{name}/{number:06d}", f"{origin}: frame {number}"
            yield Item(label, where, read, number=number, seconds=clock - first, stamp=stamp)
    finally:
        stop.set()
        reader.join(GRACE_PERIOD)


def _fill_queue(
    newest: "Queue[NewestFrame | InputError]", stop: Event, connect: Connection
) -> None:
    """Keep only the newest frame in the queue and reconnect; end with the error that stopped it."""
    failures, count, last = 0, 0, InputError("stream", "ended", "run it again when it is back")
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
        except Exception as error:  # an error in a thread would go unnoticed
            last = InputError("stream", f"{type(error).__name__}: {error}", "report it")
        failures += 1
        if not count or failures > RETRIES:
            if count:
                problem = f"{last.problem}; reconnecting failed {failures - 1} times"
                last = InputError(last.where, problem, "run it again when the stream is back")
            return newest.put(last)
        stop.wait(BACKOFF * 2 ** (failures - 1))


# --- connections ------------------------------------------------------------------------


def _read_stream(url: str) -> Generator[Callable[[], Tensor]]:
    """Yield the frames of one connection to a stream."""
    av, origin = import_av(), strip_password(url)
    options = {"rtsp_transport": "tcp", "fflags": "nobuffer"}
    try:
        with av.open(encode_url(url), options=options, timeout=TIMEOUT) as container:
            stream = main_video_stream(url, container)
            decode = frame_decoder(stream)
            for frame in container.decode(stream):
                yield partial(decode, frame)
    except (av.FFmpegError, UnicodeError) as error:
        problem = f"cannot be read: {ffmpeg_reason(error)}"
        if isinstance(error, av.error.ExitError | TimeoutError):
            problem = f"gives no answer within {TIMEOUT:g} seconds"
        raise InputError(origin, problem, "check the address and the stream") from None
    raise InputError(origin, "has ended", "check the stream")


def _read_camera(number: int) -> Generator[Callable[[], Tensor]]:
    """Yield the frames of a camera by OpenCV; PyAV's wheels lack FFmpeg's camera input."""
    with silence_opencv():
        camera = cv2.VideoCapture(number)
    try:
        if not camera.isOpened():
            devices = sorted(path.name for path in Path("/dev").glob("video*"))
            hint = f"there are {', '.join(devices)}" if devices else "no camera is connected"
            raise InputError(f"camera:{number}", "no such camera", hint)
        while True:
            is_read, pixels = camera.read()
            if not is_read:
                raise InputError(f"camera:{number}", "gives no more frames", "connect it again")
            yield partial(from_pixels, pixels[..., ::-1])
    finally:
        camera.release()
