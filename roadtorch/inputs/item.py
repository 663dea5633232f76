"""Items (images, or frames of footage) and the sources that yield them.

An image is a frame without a clock.
"""

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import islice, takewhile
from pathlib import Path, PurePosixPath
from typing import NoReturn, TypeVar

from torch import Tensor

from roadtorch.base.atomic import file_digest, folder_digest
from roadtorch.base.bounded import to_printable
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import decode_image

_Value = TypeVar("_Value")


@dataclass(frozen=True)
class Item:
    """An image or a frame of footage, decoded only when it is read.

    Attributes:
        name: relative path of its results, without suffix.
        origin: path or URL, used in messages.
        read: returns the sRGB image in [0, 1], shape (3, H, W); raises InputError.
        digest: returns the SHA-256 of the file, or of its bytes if they are given, "" if it cannot
            be read; None for frames.
        suffix: suffix of the file; empty for frames.
        file: path, if it is a file on this machine.
        number: index in the source, from 0; skipped items are counted.
        seconds: time since the start of the source; None without a clock.
        stamp: absolute time of the source in nanoseconds.
        load: returns the bytes of the file; None where only ``read`` is possible.
    """

    name: str
    origin: str
    read: Callable[[], Tensor] = field(compare=False, repr=False)
    digest: Callable[..., str] | None = field(default=None, compare=False, repr=False)
    suffix: str = ""
    file: Path | None = None
    number: int = 0
    seconds: float | None = None
    stamp: int | None = None
    load: Callable[[], bytes] | None = field(default=None, compare=False, repr=False)

    @property
    def path(self) -> Path:
        """File on this machine; InputError if it is elsewhere."""
        if self.file is None:
            raise InputError(self.origin, "is not on this machine", "give files, not URLs")
        return self.file

    def hold(self) -> "Item":
        """Return an item that reads its file once: image and digest are of the same bytes."""
        if self.load is None or self.digest is None:
            return self
        data, digest = cache(self.load), self.digest
        read = lambda: decode_image(data(), self.file or self.origin)  # noqa: E731
        return replace(self, read=read, digest=lambda: digest(data()))

    @property
    def row_name(self) -> str:
        """Name in index.csv: that of the results with the suffix of the file."""
        return to_printable(self.name + self.suffix)

    @property
    def clock(self) -> float:
        """Seconds since the start of the source; without a clock, one item a second."""
        return float(self.number) if self.seconds is None else self.seconds

    @property
    def nanoseconds(self) -> int:
        """Time stamp of the source, or else the time since its start."""
        return round(1e9 * self.clock) if self.stamp is None else self.stamp


@dataclass(frozen=True)
class Selection:
    """A selection of the items of a source.

    Attributes:
        every: keep the first of every so many items.
        start: seconds from the start of the source; without a clock, one item a second.
        end: seconds, exclusive.
        limit: maximum number of items.
        topic: image topic of bags; None if there is only one.
    """

    every: int = 1
    start: float = 0.0
    end: float | None = None
    limit: int | None = None
    topic: str | None = None

    def __post_init__(self) -> None:
        """Raise ConfigError for values that select nothing or have no meaning."""
        for name, least in {"every": 1, "limit": 1, "start": 0, "end": 0}.items():
            if (value := getattr(self, name)) is not None and not least <= value < math.inf:
                raise ConfigError(name, f"{value} was given", f"give a number from {least} on")

    def select(self, items: Iterable[Item]) -> Generator[Item]:
        """Yield the selected items, reading none beyond the last; close a generator of items."""
        until = float("inf") if self.end is None else self.end
        early = takewhile(lambda item: item.clock < until, items)
        inside = (item for item in early if not self.start or item.clock >= self.start)
        stepped = (item for index, item in enumerate(inside) if index % self.every == 0)
        try:
            yield from islice(stepped, self.limit)
        finally:
            if isinstance(items, Generator):
                items.close()

    def select_images(self, images: Sequence[_Value]) -> Sequence[_Value]:
        """Return the selected images; ConfigError if a time is given, which images lack."""
        if images and (self.start or self.end is not None):
            problem = "images have no time stamps"
            raise ConfigError("--start, --end", problem, "use --every and --limit")
        return images[:: self.every][: self.limit]


@dataclass(frozen=True)
class Source:
    """A source of frames.

    Attributes:
        name: relative path of the results, without suffix.
        origin: the input as it was given, used in messages.
        items: opens the source and yields its items in order; closing the iterator closes the
            source. Raises InputError if it cannot be opened and, after the last readable item,
            if it ends early.
        rate: items per second, if known.
        count: number of items, if known.
        live: whether the newest frame is read, as from a camera.
        path: file or folder that is read, if there is one on this machine.
        footage: whether frames follow one another in time, so that they are smoothed.
    """

    name: str
    origin: str
    items: Callable[[], Iterator[Item]]
    rate: float | None = None
    count: int | None = None
    live: bool = False
    path: Path | None = None
    footage: bool = True

    @property
    def row_name(self) -> str:
        """Name in index.csv: that of the results with the suffix of the file."""
        path = self.path or PurePosixPath(self.origin.partition("?")[0])
        return to_printable(self.name + path.suffix)

    def digest(self) -> str:
        """Return the SHA-256 of the file, or of the files in a folder; "" if there is none."""
        if self.path is None:
            return ""
        return folder_digest(self.path) if self.path.is_dir() else file_digest(self.path)

    def subsample(self, limit: int) -> "Source":
        """Return a source of at most ``limit`` evenly spaced items, the first ones if uncounted."""
        chosen = Selection(every=max(1, (self.count or 0) // limit), limit=limit)
        return replace(self, items=lambda: chosen.select(self.items()), count=None)


def raise_error(error: Exception) -> NoReturn:
    """Raise an error: what an item does on reading that is known to be unreadable."""
    raise error


def evenly_spaced(values: Sequence[_Value], limit: int) -> Sequence[_Value]:
    """Return at most ``limit`` values at equal steps, beginning with the first."""
    return values[:: max(1, -(-len(values) // limit))]
