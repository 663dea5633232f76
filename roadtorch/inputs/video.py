"""Video files: upright frames in order, with their time stamps."""

import re
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from heapq import heappop, heappush
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
from roadtorch.inputs.clock import FrameClock
from roadtorch.inputs.item import Item, Selection, Source, raise_error

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

ANSWER_TIMEOUT = 10.0  # seconds until a URL has to answer

SQUARE_TOLERANCE = 0.01  # of pixels that count as square: encoders round the aspect ratio

END_TOLERANCE = 0.5
"""Tolerated seconds from the last frame to the declared end; cameras with sound leave as much."""


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

    path: file, or URL of a video that FFmpeg reads to its end. name: relative path of the results.
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
        rate=None if rate is None else float(rate) / selection.every,
        path=path if isinstance(path, Path) else None,
    )


@contextmanager
def open_video(path: Path | str) -> "Iterator[tuple[InputContainer, VideoStream]]":
    """Open a video; yield its container and main video stream, InputError if there is none."""
    av = import_av()
    if isinstance(path, Path) and not path.is_file():
        problem = "is no file" if path.exists() else "does not exist"
        raise InputError(path, problem, "check the name")
    try:
        url = f"file:{path}" if isinstance(path, Path) else encode_url(path)
        # FFmpeg takes stamps below the first one for those of a clock that wrapped after 26 hours.
        options = {"correct_ts_overflow": "0"}
        container = av.open(url, timeout=ANSWER_TIMEOUT, container_options=options)
    except Exception as error:  # PyAV raises more than FFmpegError
        problem = f"cannot be decoded as video: {ffmpeg_reason(error)}"
        raise InputError(path, problem, "give MP4, AVI, MKV, MOV or WebM that plays") from None
    with container:
        yield container, main_video_stream(path, container)


def main_video_stream(path: Path | str, container: "InputContainer") -> "VideoStream":
    """Return the largest video stream that is no cover image; InputError if there is none."""
    disposition = import_av().stream.Disposition
    videos = [
        stream
        for stream in container.streams.video
        if not stream.disposition & disposition.attached_pic
    ]
    if not videos:
        problem = "has audio but no video" if container.streams.audio else "has no video"
        raise InputError(path, problem, "give a video")

    def rank(stream: "VideoStream") -> tuple[bool, bool, int, bool]:
        codec = stream.codec_context
        area = 0 if codec is None else codec.width * codec.height
        is_default = bool(stream.disposition & disposition.default)
        return codec is not None, stream.frames != 1, area, is_default  # one frame: a still image

    stream = max(videos, key=rank)
    if stream.codec_context is None:
        raise InputError(path, "uses a codec that FFmpeg cannot decode", "convert it to H.264")
    with report_decoding_errors(path):
        width = round(stream.codec_context.width * max(1.0, pixel_aspect(stream)))
        check_pixels(width, stream.codec_context.height)
    # A frame may be larger than the header says.
    stream.codec_context.options = {"max_pixels": f"{max_megapixels() * 1e6:.0f}"}
    # Threads decode the same images, except for damaged VP8, which shows stale memory.
    stream.thread_type = "NONE" if stream.codec_context.name == "vp8" else "AUTO"
    return stream


def ffmpeg_reason(error: Exception) -> str:
    """Return FFmpeg's message of an error, without its number and name."""
    return getattr(error, "strerror", None) or str(error)


class SeekPoint(NamedTuple):
    """Where decoding starts: packets to skip, number and time stamp of the first frame.

    first: time stamp of the first frame of the whole video.
    """

    packets: int = 0
    number: int = 0
    pts: int | None = None
    first: int | None = None


def video_frames(path: Path | str, name: str, start: float = 0.0) -> Generator[Item]:
    """Yield frames from the last key frame at or before ``start`` seconds on, named NAME/NUMBER.

    Packets before it are counted, not decoded; numbers and times do not depend on the start, nor on
    lost frames, whose items raise on reading. Frames without a time stamp follow at the frame rate.

    Raises:
        InputError: before the first frame, if the video cannot be opened; after the last, if some
            were lost, or it ends more than ``END_TOLERANCE`` before the declared duration.
    """
    seek = _find_seek_point(path, start) if start > 0 else SeekPoint()
    with open_video(path) as (container, stream):
        clock = FrameClock(strip_password(str(path)), frame_step(stream))
        number, end, lost = seek.number, 0.0, list[float]()
        failure: Exception | None = None
        if seek.number:
            clock.seconds(stream_seconds(stream, seek.first))
        decode = frame_decoder(stream)
        try:
            for pts, image in _decode_frames(container, stream, seek):
                seconds = clock.seconds(stream_seconds(stream, pts))
                origin = strip_password(f"{path}: frame {number}")
                damage = InputError(origin, "is damaged", "copy the video again, or repair it")
                read: Callable[[], Tensor] = partial(raise_error, damage)
                if image is None:
                    lost.append(seconds)
                else:
                    duration = float(image.duration or 0) * float(image.time_base or 0)
                    end = max(end, seconds + (duration or clock.step))
                    read = read if image.is_corrupt else partial(decode, image)
                yield Item(f"{name}/{number:06d}", origin, read, number=number, seconds=seconds)
                number += 1
        except import_av().FFmpegError as error:
            failure = error
        length = declared_duration(container, stream)
    is_cut = number > seek.number and not clock.stepped and end + END_TOLERANCE < length
    # A cut packet is refused by the decoder of one thread, dropped by those of several.
    if failure is not None and not (is_cut and isinstance(failure, import_av().InvalidDataError)):
        problem = f"ends after {end:.1f} seconds"
        if lost and end + END_TOLERANCE >= length:
            problem = f"lacks {len(lost)} of its frames, the first at {lost[0]:.1f} seconds"
        problem += f": {ffmpeg_reason(failure)}"
        raise InputError(path, problem, "copy it again, or repair it")
    if is_cut:
        problem = f"ends after {end:.1f} of {length:.1f} seconds"
        raise InputError(path, problem, "the rest was used; copy it again, or repair it")


def frame_step(stream: "VideoStream") -> float:
    """Return the usual seconds between frames; 0 if unknown."""
    # In AVI with ticks finer than its frames the average is the rate of ticks.
    rates = filter(None, (stream.average_rate, stream.base_rate))
    rate = min(rates, default=stream.guessed_rate)
    return float(1 / rate) if rate else 0.0


def stream_seconds(stream: "VideoStream", pts: int | None) -> float | None:
    """Return a time stamp in seconds since the start of the stream; None without one."""
    if pts is None or stream.time_base is None:
        return None
    return float((pts - (stream.start_time or 0)) * stream.time_base)


def declared_duration(container: "InputContainer", stream: "VideoStream") -> float:
    """Return the end in seconds that is declared for a video's track; 0 if none is.

    It is the track's duration, or Matroska's tag, or that of a container without other tracks.
    """
    if stream.duration:
        return float(stream.duration * (stream.time_base or 0))
    tags = (value for key, value in stream.metadata.items() if key.startswith("DURATION"))
    time = re.fullmatch(r"(\d+):(\d+):(\d+\.?\d*)", next(tags, ""))
    end = int(time[1]) * 3600 + int(time[2]) * 60 + float(time[3]) if time else 0.0
    whole = (container.duration or 0) / 1e6 if end or len(container.streams) == 1 else 0.0
    return min(filter(None, (end, whole)), default=0.0) + (stream_seconds(stream, 0) or 0.0)


def _find_seek_point(path: Path | str, start: float) -> SeekPoint:
    """Find the last key frame at or before ``start`` seconds; only the first frame is decoded.

    Where time stamps are missing or step, numbers and times need all frames: the beginning.
    """
    first = None
    with open_video(path) as (container, stream), suppress(import_av().FFmpegError):
        first, _ = next(_decode_frames(container, stream, SeekPoint()), (None, None))
    if first is None:
        return SeekPoint()
    seek, stamps, last, key = SeekPoint(), list[int](), -(2**63), -(2**63)
    with open_video(path) as (container, stream), suppress(import_av().FFmpegError):
        for index, packet in enumerate(container.demux(stream)):
            if not packet.size:
                continue
            is_step = packet.dts is not None and packet.dts < last
            if packet.pts is None or is_step or (packet.is_keyframe and packet.pts < key):
                return SeekPoint()
            last = last if packet.dts is None else packet.dts
            if packet.is_keyframe:
                if (stream_seconds(stream, packet.pts) or 0.0) > start:
                    break
                key = packet.pts
                seek = SeekPoint(index, pts=key, first=first)
            if not packet.is_discard:
                stamps.append(packet.pts)
    return seek._replace(number=sum(first <= pts < key for pts in stamps))


def _decode_frames(
    container: "InputContainer", stream: "VideoStream", seek: SeekPoint
) -> "Iterator[tuple[int | None, VideoFrame | None]]":
    """Yield time stamps and frames from a seek point on, then raise FFmpegError if one was lost.

    Frames shown before the key frame are dropped, as they depend on earlier ones. A lost frame is
    None: after an error, each packet without a frame.
    """
    av = import_av()
    errors: list[Exception] = []
    waiting: list[int] = []  # a heap of the packets' time stamps
    is_vp8, began = stream.codec_context.name == "vp8", seek.number > 0

    def is_shown(pts: int | None) -> bool:
        return seek.pts is None or pts is None or pts >= seek.pts

    def decoded(
        decode: Callable[[], "list[VideoFrame]"],
    ) -> "Iterator[tuple[int | None, VideoFrame | None]]":
        nonlocal began
        try:
            images = [image for image in decode() if is_shown(image.pts)]
        except av.FFmpegError as error:
            errors.append(error)
            return
        for image in images:
            while waiting and image.pts is not None and waiting[0] <= image.pts:
                pts = heappop(waiting)
                if errors and began and pts < image.pts:
                    yield pts, None
            began = True
            yield image.pts, image

    try:
        for packet in islice(container.demux(stream), seek.packets, None):
            is_hidden = packet.is_discard or (
                is_vp8 and packet.size and not bytes(packet)[0] & 0x10
            )
            if packet.pts is not None and is_shown(packet.pts) and not is_hidden:
                heappush(waiting, packet.pts)
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
            count += packet.size > 0 and not packet.is_discard  # an edit list hides frames
    return count


def frame_decoder(stream: "VideoStream") -> Callable[["VideoFrame"], Tensor]:
    """Return the function that decodes frames of a stream, ``upright_image``."""
    reformatter = import_av().video.reformatter.VideoReformatter()
    return partial(upright_image, reformatter, aspect=pixel_aspect(stream))


def pixel_aspect(stream: "VideoStream") -> float:
    """Return width over height of a stream's pixels; 1 where they are nearly square."""
    aspect = float(stream.sample_aspect_ratio or 1)
    return 1.0 if abs(aspect - 1) < SQUARE_TOLERANCE else aspect


def upright_image(
    reformatter: "VideoReformatter", image: "VideoFrame", aspect: float = 1.0
) -> Tensor:
    """Convert a frame to an image in [0, 1], shape (3, H, W), turned and mirrored by its metadata.

    Pixels become square, as in players: the width is multiplied by their aspect.

    The display matrix, as in ISO/IEC 14496-12, 8.3.2: x' = a x + c y, y' = b x + d y, with the
    signs of a mirror; other angles are rounded to quarter turns.

    reformatter: the stream's, which builds its tables once; a frame's own rebuilds them.
    """
    width = max(1, round(image.width * aspect))
    pixels = reformatter.reformat(image, width=width, format="rgb24").to_ndarray()
    matrix = image.side_data.get("DISPLAYMATRIX")
    if matrix is not None:
        a, b, _, c, d = np.frombuffer(matrix, np.int32)[:5].tolist()
        if abs(b) > abs(a):
            pixels, a, d = pixels.swapaxes(0, 1), c, b
        pixels = pixels[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1]
    return from_pixels(pixels)
