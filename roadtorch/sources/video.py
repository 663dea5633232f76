"""Video files: their frames in order, upright, with the time stamps that they have."""

from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from torch import Tensor

from roadtorch.errors import ConfigError, InputError
from roadtorch.io.decoding import check_pixels, most_megapixels
from roadtorch.io.image import from_pixels, undecodable
from roadtorch.sources.damage import Clock, Damage, declared, is_cut
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
        number, every = 0, video_frames(path, name, selection.start)
        with closing(selection.of(every)) as chosen:
            for number, frame in enumerate(chosen, 1):  # noqa: B007
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
    with undecodable(path):
        check_pixels(stream.codec_context.width, stream.codec_context.height)
    # A frame may be larger than what the header says.
    stream.codec_context.options = {"max_pixels": f"{most_megapixels() * 1e6:.0f}"}
    # The same pictures on all cores; but damaged VP8 shows what else was in memory.
    stream.thread_type = "NONE" if stream.codec_context.name == "vp8" else "AUTO"
    return stream


def reason_of(problem: Exception) -> str:
    """What FFmpeg says of an error, without the number and the name."""
    return getattr(problem, "strerror", None) or str(problem)


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
        clock, number = Clock(stream), begins.number
        says = declared(container, stream)
        for picture in _decoded(container, stream, begins, damage):
            seconds = clock.seconds(picture.pts)
            damage.passed(picture, seconds)
            origin = f"{path}: frame {number}"
            read = partial(_damaged, origin) if picture.is_corrupt else partial(upright, picture)
            yield Frame(number, f"{name}/{number:06d}", origin, seconds, read)
            number += 1
    if number == begins.number:
        return
    if told := damage.told(begins.number, says, is_cut(path, says)):
        raise InputError(path, told, "what could be read was used; copy it again, or repair it")


def _damaged(origin: str) -> Tensor:
    raise InputError(origin, "is damaged", "copy the video again, or repair it")


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
    container: "InputContainer", stream: "VideoStream", begins: EntryPoint, damage: Damage
) -> "Iterator[VideoFrame]":
    """The pictures from an entry point on; what cannot be decoded is counted.

    What is shown before the key frame there is left out: it is made of frames before it.
    """
    av, clock, first = import_av(), Clock(stream), begins.pts
    for packet in islice(_packets(container, stream, damage), begins.packets, None):
        if first is None and packet.is_keyframe:
            first = packet.pts
        if _is_shown(packet) and not (packet.pts is not None and first and packet.pts < first):
            damage.packets += 1
            damage.at = max(damage.at, (packet.pos or 0) + packet.size)
            if (seconds := clock.seconds(packet.pts)) >= damage.reach:
                damage.reach = seconds
                damage.lasts = (packet.duration or 0) * float(packet.time_base or 0)
        try:
            pictures = packet.decode()
        except av.FFmpegError:
            damage.refused += 1
            continue
        yield from (one for one in pictures if not (begins.pts and (one.pts or 0) < begins.pts))
    if damage.stopped:  # what the decoder still holds; else the last packet has fetched it
        with suppress(av.FFmpegError):
            yield from stream.codec_context.decode(None)


def _is_shown(packet: "Packet[VideoStream]") -> bool:
    """Whether a packet gives a picture: it has data, is in an edit, in VP8 says so (RFC 6386)."""
    is_whole = packet.size > 0 and not packet.is_discard
    return is_whole and (packet.stream.name != "vp8" or bool(memoryview(packet)[0] & 0x10))


def count_frames(path: Path) -> int:
    """The frames of a video file, counted without decoding; InputError where it is none."""
    with opened_video(path) as (container, stream):
        return sum(packet.size > 0 for packet in _packets(container, stream, Damage()))


def upright(picture: "VideoFrame") -> Tensor:
    """A decoded picture as image (3,H,W) in [0,1], turned as the video's metadata says."""
    pixels = np.rot90(picture.to_ndarray(format="rgb24"), round(picture.rotation / 90))
    return from_pixels(pixels)
