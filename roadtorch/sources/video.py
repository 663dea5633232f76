"""Video files: their frames in order, upright, with the time stamps that they have."""

from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from torch import Tensor

from roadtorch.errors import ConfigError, InputError
from roadtorch.io.image import from_pixels
from roadtorch.sources.frame import Frame, Selection, Source

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.packet import Packet
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

VIDEO_SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts", ".m2ts", ".mts"),
    *(".wmv", ".flv", ".3gp", ".ogv"),
)
"""Looked for in folders; what FFmpeg reads beside these is found by no name."""

MADE_HERE = (".overlay.mp4", ".mask.mp4", ".likelihood.mp4")  # ours; never videos to look at

SILENCE = 10.0  # seconds within which an address has to answer

SLACK = 0.5
"""Seconds by which a video may be shorter than it says before it is called cut; ours: the longest
picture-less rest beside sound that cameras leave."""


def names_video(name: str) -> bool:
    """Whether a file of that name is a video to look at, not one of ours."""
    name = name.lower()
    return name.endswith(VIDEO_SUFFIXES) and not name.endswith(MADE_HERE) and name[0] != "."


def import_av() -> Any:
    """PyAV, which reads and writes video; ConfigError naming the extra where it is missing."""
    try:
        import av
    except ImportError:
        remedy = "pip install 'roadtorch[video]'"
        raise ConfigError("video", "needs PyAV, which is not installed", remedy) from None
    return av


def video_source(path: Path | str, name: str, selection: Selection) -> Source:
    """A video file, or the address of one, as a source; what is wrong with it is told on reading.

    path: or the address of a video that FFmpeg reads to its end.
    """
    rate = None
    with suppress(InputError), opened_video(path) as (_, stream):
        rate = stream.average_rate or stream.guessed_rate

    def frames() -> Iterator[Frame]:
        number = 0
        with closing(video_frames(path, name, selection.start)) as every:
            for number, frame in enumerate(selection.of(every), 1):  # noqa: B007
                yield frame
        if not number:
            what = "has no frame" + (f" from {selection.start:g} s on" if selection.start else "")
            raise InputError(path, what, "give a video that has, or another --start and --end")

    return Source(
        name=name,
        origin=str(path),
        moving=True,
        frames=frames,
        rate=None if rate is None else float(rate),
        path=path if isinstance(path, Path) else None,
    )


# --- reading ----------------------------------------------------------------------------


@contextmanager
def opened_video(path: Path | str) -> "Iterator[tuple[InputContainer, VideoStream]]":
    """The container and its first stream of moving pictures; InputError where there is none."""
    av = import_av()
    if isinstance(path, Path) and not path.is_file():
        raise InputError(path, "does not exist", "check the name")
    try:
        container = av.open(f"file:{path}" if isinstance(path, Path) else path, timeout=SILENCE)
    except (av.FFmpegError, UnicodeError) as problem:
        what = f"cannot be decoded as video: {reason_of(problem)}"
        raise InputError(path, what, "give MP4, AVI, MKV, MOV or WebM that plays") from None
    with container:
        yield container, moving_pictures(path, container)


def moving_pictures(path: Path | str, container: "InputContainer") -> "VideoStream":
    """The first stream of a container that moves; InputError where there is none."""
    av = import_av()
    cover = av.stream.Disposition.attached_pic
    videos = [one for one in container.streams.video if not one.disposition & cover]
    if not videos:
        what = "has sound and no moving pictures" if container.streams.audio else "has no pictures"
        raise InputError(path, what, "give a video")
    stream = videos[0]
    if stream.codec_context is None:
        raise InputError(path, "is of a codec that FFmpeg cannot decode", "convert it to H.264")
    stream.thread_type = "AUTO"  # the same pictures, on all cores
    return stream


def reason_of(problem: Exception) -> str:
    """What FFmpeg says of an error, without the number and the name."""
    return getattr(problem, "strerror", None) or str(problem)


@dataclass
class Damage:
    """What went wrong while a video was read."""

    packets: int = 0
    pictures: int = 0
    stopped: str = ""

    def told(self, seconds: float, lasts: float) -> str:
        """In words; empty where nothing is missing. Both in seconds: what was read, what it says.

        Being shorter by ``SLACK`` or less is nothing.
        """
        parts = []
        if self.stopped or seconds + SLACK < lasts:
            of = f" of {lasts:.1f}" if lasts else ""
            parts.append(f"ends early, after {seconds:.1f}{of} seconds")
        parts += [f"packets that cannot be decoded: {self.packets}"] if self.packets else []
        parts += [f"damaged frames: {self.pictures}"] if self.pictures else []
        return ", ".join(parts)


class EntryPoint(NamedTuple):
    """Where decoding begins: packets passed over, number and time stamp of the first frame."""

    packets: int = 0
    number: int = 0
    pts: int | None = None


def video_frames(path: Path | str, name: str, start: float = 0.0) -> Generator[Frame]:
    """Every frame from the last key frame at or before ``start`` seconds on, named NAME/NUMBER.

    What lies ahead of that key frame is counted, not decoded, so that a frame has the same number
    whatever the start. Frames without a time stamp follow at the stream's rate. Raises InputError
    when it cannot be opened, and behind the last frame that can be read when some are missing.
    """
    begins = _entry_point(path, start) if start > 0 else EntryPoint()
    damage = Damage()
    with opened_video(path) as (container, stream):
        clock = Clock(stream)
        lasts = clock.lasts or (container.duration or 0) / 1e6  # it is in microseconds
        number, seconds = begins.number, 0.0
        for picture in _decoded(container, stream, begins.packets, damage):
            if picture.pts is not None and begins.pts is not None and picture.pts < begins.pts:
                continue  # shown before the key frame, and made of frames that were passed over
            seconds = clock.seconds(picture.pts)
            read = partial(upright, picture)
            yield Frame(number, f"{name}/{number:06d}", f"{path}: frame {number}", seconds, read)
            number += 1
        told = damage.told(clock.seconds(None) if number else 0.0, lasts)
    if told and number > begins.number:
        raise InputError(path, told, "what could be read was used; copy it again, or repair it")


class Clock:
    """Seconds since a stream began, of its time stamps; where one is missing, by its rate."""

    def __init__(self, stream: "VideoStream") -> None:
        rate = stream.average_rate or stream.guessed_rate
        self._base, self._zero = stream.time_base, stream.start_time
        self._step = float(1 / rate) if rate else 0.0
        self._last: float | None = None
        self.lasts = float((stream.duration or 0) * (self._base or 0))

    def seconds(self, pts: int | None) -> float:
        """Of one frame after the other."""
        if pts is None or self._base is None:
            self._last = 0.0 if self._last is None else self._last + self._step
        else:
            self._zero = pts if self._zero is None else self._zero
            self._last = float((pts - self._zero) * self._base)
        return self._last


def _entry_point(path: Path | str, start: float) -> EntryPoint:
    """The last key frame at or before ``start`` seconds, found without decoding."""
    begins, leading = EntryPoint(), 0
    with opened_video(path) as (container, stream):
        clock = Clock(stream)
        for at, packet in enumerate(_packets(container, stream, Damage())):
            if packet.pts is None:
                continue
            seconds = clock.seconds(packet.pts)
            if packet.is_keyframe and seconds > start:
                break
            if packet.is_keyframe:
                begins, leading = EntryPoint(at, at, packet.pts), 0
            elif begins.pts is not None and packet.pts < begins.pts:
                leading += 1
    return begins._replace(number=begins.number + leading)


def _packets(
    container: "InputContainer", stream: "VideoStream", damage: Damage
) -> "Iterator[Packet[VideoStream]]":
    """The packets of a stream, as far as they can be read; the last one is empty."""
    try:
        yield from container.demux(stream)
    except import_av().FFmpegError as problem:
        damage.stopped = reason_of(problem)


def _decoded(
    container: "InputContainer", stream: "VideoStream", skip: int, damage: Damage
) -> "Iterator[VideoFrame]":
    """The pictures of all packets but the first ``skip``; what cannot be decoded is counted."""
    av = import_av()
    for packet in islice(_packets(container, stream, damage), skip, None):
        try:
            pictures = packet.decode()
        except av.FFmpegError:
            damage.packets += 1
            continue
        for picture in pictures:
            damage.pictures += picture.is_corrupt
            yield picture
    if damage.stopped:  # what the decoder still holds; else the last packet has fetched it
        with suppress(av.FFmpegError):
            yield from stream.codec_context.decode(None)


def count_frames(path: Path) -> int:
    """The frames of a video file, counted without decoding; InputError where it is none."""
    with opened_video(path) as (container, stream):
        return sum(packet.size > 0 for packet in _packets(container, stream, Damage()))


def upright(picture: "VideoFrame") -> Tensor:
    """A decoded picture as image (3,H,W) in [0,1], turned as the video's metadata says."""
    pixels = np.rot90(picture.to_ndarray(format="rgb24"), round(picture.rotation / 90))
    return from_pixels(pixels)
