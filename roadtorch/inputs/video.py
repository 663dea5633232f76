"""Video files: upright frames in order, with their time stamps."""

from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from torch import Tensor

from roadtorch.base.bounded import strip_password
from roadtorch.base.decoding import check_pixels, max_megapixels
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import from_pixels, report_decoding_errors
from roadtorch.base.urls import encode_url
from roadtorch.inputs.item import Item, Selection, Source

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.reformatter import VideoReformatter
    from av.video.stream import VideoStream

VIDEO_SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts", ".m2ts", ".mts"),
    *(".wmv", ".flv", ".3gp", ".ogv"),
)
"""Suffixes that folders are searched for; FFmpeg reads further ones, if named."""

VIDEO_RESULTS = (".overlay.mp4", ".mask.mp4", ".likelihood.mp4")  # our results, never inputs
ANSWER_TIMEOUT = 10.0  # seconds until a URL has to answer

END_TOLERANCE = 0.5
"""Tolerated seconds from the last frame to the declared end; cameras with sound leave as much."""


def is_video_name(name: str) -> bool:
    """Return whether a file name is that of a video and of no result of roadtorch."""
    name = name.lower()
    return name.endswith(VIDEO_SUFFIXES) and not name.endswith(VIDEO_RESULTS) and name[0] != "."


def import_av() -> Any:
    """Import PyAV, which reads and writes video; ConfigError naming the extra if it is missing."""
    try:
        import av
    except ImportError:
        hint = "pip install 'roadtorch[video]'"
        raise ConfigError("video", "needs PyAV, which is not installed", hint) from None
    return av


def video_source(path: Path | str, name: str, selection: Selection) -> Source:
    """Make a source of a video; what is wrong with it is raised on reading.

    Args:
        path: file, or URL of a video that FFmpeg reads to its end.
        name: relative path of the results.
        selection: selection of the frames.
    """
    rate = None
    with suppress(InputError), open_video(path) as (_, stream):
        rate = stream.average_rate or stream.guessed_rate

    def frames() -> Iterator[Item]:
        count, every = 0, video_frames(path, name, selection.start)
        with closing(selection.select(every)) as chosen:
            for count, frame in enumerate(chosen, 1):  # noqa: B007
                yield frame
        if not count:
            begin = f" from {selection.start:g} s on" if selection.start else ""
            raise InputError(path, f"has no frame{begin}", "give another video, --start or --end")

    return Source(
        name=name,
        origin=strip_password(str(path)),
        items=frames,
        rate=None if rate is None else float(rate),
        path=path if isinstance(path, Path) else None,
    )


# --- reading ----------------------------------------------------------------------------


@contextmanager
def open_video(path: Path | str) -> "Iterator[tuple[InputContainer, VideoStream]]":
    """Open a video; yield its container and first video stream, InputError if there is none."""
    av = import_av()
    if isinstance(path, Path) and not path.is_file():
        problem = "is no file" if path.exists() else "does not exist"
        raise InputError(path, problem, "check the name")
    try:
        url = f"file:{path}" if isinstance(path, Path) else encode_url(path)
        container = av.open(url, timeout=ANSWER_TIMEOUT)
    except (av.FFmpegError, UnicodeError) as error:
        problem = f"cannot be decoded as video: {ffmpeg_reason(error)}"
        raise InputError(path, problem, "give MP4, AVI, MKV, MOV or WebM that plays") from None
    with container:
        yield container, first_video_stream(path, container)


def first_video_stream(path: Path | str, container: "InputContainer") -> "VideoStream":
    """Return the first video stream that is no cover image; InputError if there is none."""
    cover = import_av().stream.Disposition.attached_pic
    videos = [stream for stream in container.streams.video if not stream.disposition & cover]
    if not videos:
        problem = "has audio but no video" if container.streams.audio else "has no video"
        raise InputError(path, problem, "give a video")
    stream = videos[0]
    if stream.codec_context is None:
        raise InputError(path, "uses a codec that FFmpeg cannot decode", "convert it to H.264")
    with report_decoding_errors(path):
        check_pixels(stream.codec_context.width, stream.codec_context.height)
    # A frame may be larger than the header says.
    stream.codec_context.options = {"max_pixels": f"{max_megapixels() * 1e6:.0f}"}
    # Threads decode the same images, except for damaged VP8, which shows stale memory.
    stream.thread_type = "NONE" if stream.codec_context.name == "vp8" else "AUTO"
    return stream


def ffmpeg_reason(error: Exception) -> str:
    """Return FFmpeg's message of an error, without its number and name."""
    return getattr(error, "strerror", None) or str(error)


class StreamClock:
    """Seconds since the start of a stream, by time stamps or else by the frame rate."""

    def __init__(self, stream: "VideoStream") -> None:
        # In AVI with ticks finer than its frames the average is the rate of ticks.
        rates = filter(None, (stream.average_rate, stream.base_rate))
        rate = min(rates, default=stream.guessed_rate)
        self._base, self._zero = stream.time_base, stream.start_time
        self.step = float(1 / rate) if rate else 0.0
        self._last: float | None = None

    def seconds(self, pts: int | None) -> float:
        """Return the time of the next frame."""
        if pts is None or self._base is None:
            self._last = 0.0 if self._last is None else self._last + self.step
        else:
            self._zero = pts if self._zero is None else self._zero
            self._last = float((pts - self._zero) * self._base)
        return self._last


class SeekPoint(NamedTuple):
    """Where decoding starts: packets to skip, number and time stamp of the first frame."""

    packets: int = 0
    number: int = 0
    pts: int | None = None


def video_frames(path: Path | str, name: str, start: float = 0.0) -> Generator[Item]:
    """Yield frames from the last key frame at or before ``start`` on, named NAME/NUMBER.

    Packets before it are counted, not decoded, so that frame numbers do not depend on the start.
    Frames without a time stamp follow at the frame rate.

    Args:
        path: file or URL.
        name: prefix of the frames' names.
        start: seconds.

    Raises:
        InputError: if the video cannot be opened and, after the last frame, if FFmpeg cannot read
            on or it ends more than ``END_TOLERANCE`` before the declared duration.
    """
    seek = _find_seek_point(path, start) if start > 0 else SeekPoint()
    with open_video(path) as (container, stream):
        clock, number, end = StreamClock(stream), seek.number, 0.0
        decode = partial(upright_image, import_av().video.reformatter.VideoReformatter())
        try:
            for image in _decode_frames(container, stream, seek):
                seconds = clock.seconds(image.pts)
                duration = float(image.duration or 0) * float(image.time_base or 0)
                end = max(end, seconds + (duration or clock.step))
                origin = strip_password(f"{path}: frame {number}")
                read = (
                    partial(_raise_damaged, origin) if image.is_corrupt else partial(decode, image)
                )
                yield Item(f"{name}/{number:06d}", origin, read, number=number, seconds=seconds)
                number += 1
        except import_av().FFmpegError as error:
            problem = f"ends after {end:.1f} seconds: {ffmpeg_reason(error)}"
            raise InputError(path, problem, "copy it again, or repair it") from None
        length = declared_duration(container, stream)
    if number > seek.number and end + END_TOLERANCE < length:
        problem = f"ends after {end:.1f} of {length:.1f} seconds"
        raise InputError(path, problem, "the rest was used; copy it again, or repair it")


def declared_duration(container: "InputContainer", stream: "VideoStream") -> float:
    """Return the duration in seconds that the container declares; 0 if it declares none."""
    if stream.duration:
        return float(stream.duration * (stream.time_base or 0))
    return (container.duration or 0) / 1e6  # in microseconds


def _raise_damaged(origin: str) -> Tensor:
    raise InputError(origin, "is damaged", "copy the video again, or repair it")


def _find_seek_point(path: Path | str, start: float) -> SeekPoint:
    """Find the last key frame at or before ``start`` seconds without decoding."""
    seek, leading = SeekPoint(), 0
    with open_video(path) as (container, stream), suppress(import_av().FFmpegError):
        clock = StreamClock(stream)
        for index, packet in enumerate(container.demux(stream)):
            if packet.pts is None:
                continue
            seconds = clock.seconds(packet.pts)
            if packet.is_keyframe and seconds > start:
                break
            if packet.is_keyframe:
                seek, leading = SeekPoint(index, index, packet.pts), 0
            elif seek.pts is not None and packet.pts < seek.pts:
                leading += 1
    return seek._replace(number=seek.number + leading)


def _decode_frames(
    container: "InputContainer", stream: "VideoStream", seek: SeekPoint
) -> "Iterator[VideoFrame]":
    """Yield the frames from a seek point on, then raise FFmpegError if one cannot be decoded.

    Frames shown before the key frame are dropped, as they depend on earlier ones.
    """
    av, first = import_av(), seek.pts or 0
    errors: list[Exception] = []

    def decoded(decode: Callable[[], "list[VideoFrame]"]) -> "list[VideoFrame]":
        try:
            return [image for image in decode() if not (first and (image.pts or 0) < first)]
        except av.FFmpegError as error:
            errors.append(error)
            return []

    try:
        for packet in islice(container.demux(stream), seek.packets, None):
            yield from decoded(packet.decode)
    except av.FFmpegError as error:
        errors.insert(0, error)
        yield from decoded(partial(stream.codec_context.decode, None))  # frames still buffered
    if errors:
        raise errors[0]


def count_frames(path: Path) -> int:
    """Count the frames of a video file without decoding; InputError if it is no video."""
    count = 0
    with open_video(path) as (container, stream), suppress(import_av().FFmpegError):
        for packet in container.demux(stream):
            count += packet.size > 0
    return count


def upright_image(reformatter: "VideoReformatter", image: "VideoFrame") -> Tensor:
    """Convert a frame to an image in [0, 1], shape (3, H, W), rotated as the metadata says.

    Args:
        reformatter: the stream's, which builds its tables once; a frame's own rebuilds them.
        image: the decoded frame.
    """
    pixels = reformatter.reformat(image, format="rgb24").to_ndarray()
    return from_pixels(np.rot90(pixels, round(image.rotation / 90)))
