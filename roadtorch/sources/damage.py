"""What a video lacks: its length and its structure against the pictures that could be read."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

SLACK = 0.5
"""Seconds without pictures that are no damage: at the end beside sound, or where a recorder paused;
ours: the longest that cameras leave. At one rate, and of a length of its own, it may lack none."""

REGULAR = 0.9
"""Share of pictures that follow at one rate, from which a hole in their time stamps is damage."""

TAIL = 0.2
"""Share of a file that may follow its last frame where it does not say how long it is; ours."""

CONTAINERS = {0x18538067, 0x1F43B675}  # Segment and Cluster: what they hold follows them
ELEMENTS = {
    *(0x1A45DFA3, 0x114D9B74, 0x1549A966, 0x1654AE6B, 0x1C53BB6B, 0x1941A469, 0x1043A770),
    *(0x1254C367, 0xEC, 0xBF, 0xE7, 0x5854, 0xA7, 0xAB, 0xA3, 0xA0, 0xAF),
}
"""What stands in a file of Matroska, in its segment and in its clusters (RFC 9559, section 5)."""


class Clock:
    """Seconds since a stream began, of its time stamps; where one is missing, by its rate."""

    def __init__(self, stream: "VideoStream") -> None:
        # In AVI whose ticks are finer than its frames the average is that of ticks.
        rates = filter(None, (stream.average_rate, stream.base_rate))
        rate = min(rates, default=stream.guessed_rate)
        self._base, self._zero = stream.time_base, stream.start_time
        self._step = float(1 / rate) if rate else 0.0
        self._last: float | None = None

    def seconds(self, pts: int | None) -> float:
        """Of one frame after the other."""
        if pts is None or self._base is None:
            self._last = 0.0 if self._last is None else self._last + self._step
        else:
            self._zero = pts if self._zero is None else self._zero
            self._last = float((pts - self._zero) * self._base)
        return self._last


class Declared(NamedTuple):
    """What a video says of itself: its seconds, whether they are of its pictures alone, its bytes.

    is_counted: whether the seconds are a number of frames. form: the name of its container.
    """

    seconds: float
    is_own: bool
    size: int
    is_counted: bool
    form: str


def declared(container: "InputContainer", stream: "VideoStream") -> Declared:
    """What a video says of itself.

    AVI counts its frames, in its time base, and FFmpeg takes less for the duration where it is cut.
    """
    form = container.format.name
    count = stream.frames if form == "avi" else 0
    lasts = float(max(stream.duration or 0, count) * (stream.time_base or 0))
    of_all = (container.duration or 0) / 1e6  # in microseconds
    is_alone = all(one.type == "video" for one in container.streams)
    seconds = max(lasts, of_all) if is_alone else lasts or of_all
    return Declared(seconds, lasts > 0 or is_alone, container.size, count > 0, form)


def is_cut(path: Path | str, says: Declared) -> bool:
    """Whether parts of a file go on behind its end, or are none; False of what has no such parts.

    The heads of all parts are read, some a frame.
    """
    looks = {"avi": _is_cut_avi, "matroska,webm": _is_cut_matroska}
    if not isinstance(path, Path) or says.form not in looks:
        return False
    with path.open("rb", buffering=64) as file:
        return looks[says.form](file, says.size)


def _is_cut_avi(file: IO[bytes], size: int) -> bool:
    """Whether the first RIFF of a file is longer than the file, or none."""
    name, length = file.read(4), int.from_bytes(file.read(4), "little")
    return name != b"RIFF" or file.tell() + length > size


def _is_cut_matroska(file: IO[bytes], size: int) -> bool:
    """Whether elements of a file go on behind its end, or are none that stand there."""
    while file.tell() < size:
        name, _ = _number(file)
        length, most = _number(file)
        length &= most
        is_open = length == most  # until another element follows, as in what was sent live
        if not is_open and file.tell() + length > size:
            return True
        if name not in CONTAINERS:
            if name not in ELEMENTS or is_open:
                return True
            file.seek(length, 1)
    return False


def _number(file: IO[bytes]) -> tuple[int, int]:
    """A number of Matroska with its marker, and the largest that as many bytes hold without."""
    first = file.read(1) or b"\0"
    length = 9 - first[0].bit_length()
    return int.from_bytes(first + file.read(length - 1)), (1 << 7 * length) - 1


@dataclass
class Damage:
    """What was counted while a video was read, from which it is known what is missing.

    packets: that hold a picture to be shown; reach, lasts, at: the last of them begins at so many
    seconds, lasts as long (0: not known) and ends at so many bytes of the file.
    times: begin and length of each picture in seconds.
    """

    packets: int = 0
    refused: int = 0
    corrupt: int = 0
    interlaced: bool = False
    reach: float = 0.0
    lasts: float = 0.0
    at: int = 0
    stopped: str = ""
    times: list[tuple[float, float]] = field(default_factory=list)

    def passed(self, picture: "VideoFrame", seconds: float) -> None:
        """Count a picture that is shown at so many seconds."""
        self.corrupt += picture.is_corrupt
        self.interlaced |= picture.interlaced_frame
        lasts = float(getattr(picture, "duration", None) or 0) * float(picture.time_base or 0)
        self.times.append((seconds, lasts))

    def told(self, ahead: int, says: Declared, cut: bool) -> str:
        """In words; empty where nothing is missing.

        ahead: frames that were passed over. cut: see ``is_cut``.
        """
        begins, lengths = np.array(self.times).reshape(-1, 2).T
        steps = np.diff(begins)
        step = float(np.median(steps)) if len(steps) else self.lasts
        read, every = ahead + len(begins), ahead + self.packets
        if self.interlaced and 2 * len(begins) >= self.packets:
            every = read  # a packet a field
        is_regular = step > 0 and (abs(steps - step) < step / 4).sum() >= REGULAR * len(steps)
        slack = min(SLACK, 0.75 * step) if is_regular and says.is_own else SLACK
        end, parts = self.reach + (self.lasts or step), []
        if not says.seconds and self.at < (1 - TAIL) * says.size:
            self.stopped = self.stopped or "the rest holds no frames"
        if self.stopped or cut or end + slack < says.seconds:
            of = f" of {says.seconds:.1f}" if says.seconds else ""
            parts.append(f"ends early, after {end:.1f}{of} seconds")
        if is_regular:
            holes = steps - np.maximum(step, lengths[:-1])
            lost = np.round(holes[holes > max(SLACK, 2 * step)] / step).sum()
            every = max(every, read + int(lost), round(says.seconds / step) if parts else 0)
            if says.is_counted and len(steps):  # where a frame may also last longer
                every = max(every, round((says.seconds - (steps - step).sum()) / step))
        parts = [f"{read} of {every} frames", *parts] if read < every else parts
        parts += [f"packets that cannot be decoded: {self.refused}"] if self.refused else []
        parts += [f"damaged frames: {self.corrupt}"] if self.corrupt else []
        return ", ".join(parts)
