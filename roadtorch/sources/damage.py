"""What a video lacks: its time stamps and its length against the pictures that could be read."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

SLACK = 0.5
"""Seconds without pictures that are no damage: at the end beside sound, or where a recorder paused;
ours: the longest that cameras leave. At one rate, and of a length of its own, it may lack none."""

REGULAR = 0.9
"""Share of pictures that follow at one rate, from which a hole in their time stamps is damage."""


class Clock:
    """Seconds since a stream began, of its time stamps; where one is missing, by its rate.

    step: seconds between two frames of that rate; 0 where it is not known.
    """

    def __init__(self, stream: "VideoStream") -> None:
        # In AVI whose ticks are finer than its frames the average is that of ticks.
        rates = filter(None, (stream.average_rate, stream.base_rate))
        rate = min(rates, default=stream.guessed_rate)
        self._base, self._zero = stream.time_base, stream.start_time
        self.step = float(1 / rate) if rate else 0.0
        self._last: float | None = None

    def seconds(self, pts: int | None) -> float:
        """Of one frame after the other."""
        if pts is None or self._base is None:
            self._last = 0.0 if self._last is None else self._last + self.step
        else:
            self._zero = pts if self._zero is None else self._zero
            self._last = float((pts - self._zero) * self._base)
        return self._last


def declared_length(container: "InputContainer", stream: "VideoStream") -> tuple[float, bool]:
    """The seconds that a video says it has, and whether they are of its pictures alone.

    AVI counts its frames, in its time base, and FFmpeg takes less for the duration where it is cut.
    """
    count = stream.frames if container.format.name == "avi" else 0
    lasts = float(max(stream.duration or 0, count) * (stream.time_base or 0))
    is_own = lasts > 0 or len(container.streams) == 1
    return lasts or (container.duration or 0) / 1e6, is_own  # the latter is in microseconds


@dataclass
class Damage:
    """What was counted while a video was read, from which it is known what is missing.

    packets: that hold a picture to be shown; reach, at: the last of them ends at so many seconds,
    and bytes of the file.
    regular: pictures that follow at the stream's rate; lost: frames in holes between pictures.
    """

    packets: int = 0
    refused: int = 0
    pictures: int = 0
    corrupt: int = 0
    interlaced: bool = False
    regular: int = 0
    lost: int = 0
    reach: float = 0.0
    at: int = 0
    stopped: str = ""
    _end: float | None = None

    def passed(self, picture: "VideoFrame", seconds: float, step: float) -> None:
        """Count a picture at so many seconds of a stream with a frame each ``step`` seconds."""
        self.pictures += 1
        self.corrupt += picture.is_corrupt
        self.interlaced |= picture.interlaced_frame
        hole = 0.0 if self._end is None else seconds - self._end
        self.regular += abs(hole) < step / 4
        if step and hole > max(SLACK, 2 * step):
            self.lost += round(hole / step)
        base = picture.time_base or 0
        self._end = seconds + max(
            step, float(getattr(picture, "duration", None) or 0) * float(base)
        )

    def told(self, ahead: int, step: float, lasts: float, is_own: bool) -> str:
        """In words; empty where nothing is missing.

        ahead: frames that were passed over. step: see ``passed``. lasts, is_own: see
        ``declared_length``.
        """
        read, every = ahead + self.pictures, ahead + self.packets
        if self.interlaced and 2 * self.pictures >= self.packets:
            every = read  # a packet a field
        is_regular = step > 0 and self.regular >= REGULAR * self.pictures
        slack = min(SLACK, 0.75 * step) if is_regular and is_own else SLACK
        parts = []
        if self.stopped or self.reach + slack < lasts:
            of = f" of {lasts:.1f}" if lasts else ""
            parts.append(f"ends early, after {self.reach:.1f}{of} seconds")
        if is_regular:
            every = max(every, read + self.lost, round(lasts / step) if parts else 0)
        parts = [f"{read} of {every} frames", *parts] if read < every else parts
        parts += [f"packets that cannot be decoded: {self.refused}"] if self.refused else []
        parts += [f"damaged frames: {self.corrupt}"] if self.corrupt else []
        return ", ".join(parts)
