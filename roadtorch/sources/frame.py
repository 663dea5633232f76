"""Frames with time stamps, and the sources that give them one after the other."""

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, takewhile
from pathlib import Path
from typing import TypeVar

from torch import Tensor

from roadtorch.errors import ConfigError

Item = TypeVar("Item")


@dataclass(frozen=True)
class Frame:
    """One picture of a source; it is decoded only when it is read.

    number: its place in the source, from 0, whatever is left out. name: of its results, relative,
    without suffix. origin: what messages call it. seconds: since the source began; None where it
    has no clock. stamp: the source's own absolute time in nanoseconds, where it has one.
    read: gives the image float32 (3,H,W) in [0,1]; raises InputError naming ``origin``.
    """

    number: int
    name: str
    origin: str
    seconds: float | None
    read: Callable[[], Tensor]
    stamp: int | None = None


@dataclass(frozen=True)
class Selection:
    """Which frames of a source to look at.

    every: the first of so many frames. start, end: seconds since the source began, the end left
    out; frames without a clock are counted as one a second. limit: at most so many frames.
    """

    every: int = 1
    start: float = 0.0
    end: float | None = None
    limit: int | None = None

    def of(self, frames: Iterable[Frame]) -> Generator[Frame]:
        """The chosen frames; no frame is asked for behind the last one.

        A generator of frames is closed at the end, or when this one is.
        """
        until = float("inf") if self.end is None else self.end
        early = takewhile(lambda frame: _clock(frame) < until, frames)
        inside = (frame for frame in early if _clock(frame) >= self.start)
        stepped = (frame for at, frame in enumerate(inside) if at % self.every == 0)
        try:
            yield from islice(stepped, self.limit)
        finally:
            if isinstance(frames, Generator):
                frames.close()

    def of_pictures(self, pictures: Sequence[Item]) -> Sequence[Item]:
        """The chosen ones of pictures that stand alone; ConfigError when seconds are asked for."""
        if pictures and (self.start or self.end is not None):
            what = "pictures have no time"
            raise ConfigError("--start, --end", what, "choose with --every and --limit")
        return pictures[:: self.every][: self.limit]


def _clock(frame: Frame) -> float:
    return float(frame.number) if frame.seconds is None else frame.seconds


@dataclass(frozen=True)
class Source:
    """Where frames come from.

    name: of the results, relative, without suffix. origin: as it was given, for messages.
    moving: whether the frames follow one another in time (video, camera, bag), else they are
    pictures of their own (an archive's members). rate: frames a second, where it is known.
    count: how many frames ``frames`` gives, where it is known.
    frames: opens the source and gives its chosen frames, each once, in order. Closing the iterator
    closes the source. It raises InputError naming ``origin`` when it cannot be opened, and, behind
    the last frame that can be read, when it ends before its end.
    live: whether it gives the newest frame whenever it is asked, so that nothing is read ahead.
    path: the file whose bytes it is made of, where it is one.
    """

    name: str
    origin: str
    moving: bool
    frames: Callable[[], Iterator[Frame]]
    rate: float | None = None
    count: int | None = None
    live: bool = False
    path: Path | None = None


def spread(items: Sequence[Item], most: int) -> Sequence[Item]:
    """At most ``most`` of them, evenly: the first, and every so many-th."""
    return items[:: max(1, -(-len(items) // most))]


def sampled(source: Source, most: int) -> Source:
    """At most so many frames of a source, evenly spaced; the first ones where it has no count."""
    chosen = Selection(every=max(1, (source.count or 0) // most), limit=most)
    return replace(source, frames=lambda: chosen.of(source.frames()), count=None)
