"""What is looked at: items, which are images or frames of footage, and the sources of frames.

An image is a frame without a clock.
"""

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, takewhile
from pathlib import Path
from typing import TypeVar

from torch import Tensor

from roadtorch.base.atomic import digest_of, digest_of_folder
from roadtorch.base.bounded import printable
from roadtorch.base.errors import ConfigError, InputError

Value = TypeVar("Value")


@dataclass(frozen=True)
class Item:
    """An image, or a frame of footage; it is decoded only when it is read.

    name: of its results, relative, sub-folders kept, without suffix. origin: its path or URL, what
    messages call it. read: gives the image float32 (3,H,W) in [0,1]; raises InputError naming
    ``origin``. digest: gives the SHA-256 of its bytes, empty where they cannot be read; None for a
    frame, whose source has one. suffix: of its file, empty for a frame. file: its path, where it is
    a file of this machine.
    number: its place in a source, from 0, whatever is left out. seconds: since the source began;
    None where it has no clock. stamp: the source's own absolute time in nanoseconds.
    """

    name: str
    origin: str
    read: Callable[[], Tensor] = field(compare=False, repr=False)
    digest: Callable[[], str] | None = field(default=None, compare=False, repr=False)
    suffix: str = ""
    file: Path | None = None
    number: int = 0
    seconds: float | None = None
    stamp: int | None = None

    @property
    def path(self) -> Path:
        """Its file on this machine; InputError for one that is elsewhere."""
        if self.file is None:
            raise InputError(self.origin, "is not on this machine", "give files, not URLs")
        return self.file

    @property
    def row_name(self) -> str:
        """What index.csv calls it: the name of its results with its own suffix."""
        return printable(self.name + self.suffix)

    @property
    def clock(self) -> float:
        """Seconds since its source began; a frame without a clock is one a second."""
        return float(self.number) if self.seconds is None else self.seconds

    @property
    def nanoseconds(self) -> int:
        """Its time stamp: the source's own, else since the source began."""
        return round(1e9 * self.clock) if self.stamp is None else self.stamp


@dataclass(frozen=True)
class Selection:
    """Which items of a source to look at.

    every: the first of so many. start, end: seconds since the source began, the end left out;
    frames without a clock are counted as one a second. limit: at most so many. topic: of the
    images in bags; None where they have one.
    """

    every: int = 1
    start: float = 0.0
    end: float | None = None
    limit: int | None = None
    topic: str | None = None

    def of(self, items: Iterable[Item]) -> Generator[Item]:
        """The chosen items; none is asked for behind the last one.

        A generator of items is closed at the end, or when this one is.
        """
        until = float("inf") if self.end is None else self.end
        early = takewhile(lambda item: item.clock < until, items)
        inside = (item for item in early if item.clock >= self.start)
        stepped = (item for place, item in enumerate(inside) if place % self.every == 0)
        try:
            yield from islice(stepped, self.limit)
        finally:
            if isinstance(items, Generator):
                items.close()

    def of_images(self, images: Sequence[Value]) -> Sequence[Value]:
        """The chosen ones of images that stand alone; ConfigError when seconds are asked for."""
        if images and (self.start or self.end is not None):
            problem = "images have no time"
            raise ConfigError("--start, --end", problem, "choose with --every and --limit")
        return images[:: self.every][: self.limit]


@dataclass(frozen=True)
class Source:
    """Where frames come from.

    name: of the results, relative, without suffix. origin: as it was given, for messages.
    rate: items a second, where it is known.
    count: how many ``items`` gives, where it is known.
    items: opens the source and gives its chosen items, each once, in order. Closing the iterator
    closes the source. It raises InputError naming ``origin`` when it cannot be opened, and, behind
    the last item that can be read, when it ends before its end.
    live: whether it gives the newest frame whenever it is asked.
    path: the file whose bytes it is made of, where it is one.
    """

    name: str
    origin: str
    items: Callable[[], Iterator[Item]]
    rate: float | None = None
    count: int | None = None
    live: bool = False
    path: Path | None = None

    @property
    def row_name(self) -> str:
        """What index.csv calls it: the name of its results with its own suffix."""
        return printable(self.name + self._location.suffix)

    @property
    def _location(self) -> Path:
        return self.path or Path(self.origin)

    def digest(self) -> str:
        """SHA-256 of its file, or of all files in its folder; empty where there is none."""
        path = self._location
        return digest_of_folder(path) if path.is_dir() else digest_of(path)

    def sampled(self, most: int) -> "Source":
        """At most so many of its items, evenly spaced; the first ones where it has no count."""
        chosen = Selection(every=max(1, (self.count or 0) // most), limit=most)
        return replace(self, items=lambda: chosen.of(self.items()), count=None)


def spread(values: Sequence[Value], most: int) -> Sequence[Value]:
    """At most ``most`` of them, evenly: the first, and every so many-th."""
    return values[:: max(1, -(-len(values) // most))]
