"""The folder of pictures that is corrected, and one person's work on one of them, by its log."""

import hashlib
import os
import re
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from roadtorch.data.correction_formats import FORMATS
from roadtorch.data.correction_labels import LABELS
from roadtorch.data.event_log import EventLog, LogHead, append_event, log_path, read_log
from roadtorch.data.events import (
    AnyEvent,
    Confirm,
    Import,
    LastingEvent,
    Redo,
    Undo,
    apply_event,
    folded,
    runs_of,
    standing,
)
from roadtorch.data.labelme import picture_size
from roadtorch.errors import InputError
from roadtorch.io.bounded import printable
from roadtorch.sources.pictures import find_images

FRESH = 2.0  # seconds for which a listing holds

USER = re.compile(r"[A-Za-z0-9_-]{1,32}")


@dataclass
class PictureFolder:
    """The pictures below ``root``, by their relative name with ending; ``apart`` is left out."""

    root: Path
    apart: Path
    _names: tuple[str, ...] = ()
    _listed: float = field(default=-FRESH, repr=False)
    _known: set[str] = field(default_factory=set, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def __post_init__(self) -> None:
        self.root, self.apart = self.root.resolve(), self.apart.resolve()

    def names(self) -> tuple[str, ...]:
        """What is there now, sorted; looked up anew after ``FRESH`` seconds."""
        with self._lock:
            if time.monotonic() - self._listed >= FRESH:
                try:
                    found = [one.path for one in find_images([self.root], self.apart)]
                except InputError:  # emptied while the page is open
                    found = []
                inside = [one for one in found if one.resolve().is_relative_to(self.root)]
                names = [one.relative_to(self.root).as_posix() for one in inside]
                self._names = tuple(one for one in names if one == printable(one))
                self._known.update(self._names)
                self._listed = time.monotonic()
            return self._names

    def path(self, name: str) -> Path:
        """The file of a name that came from outside.

        Raises InputError for one that was never in ``names``, letter by letter, one that leads out
        of the folder by now, and one that is gone.
        """
        self.names()
        path = self.root / name if name in self._known else None
        if path is None or not path.resolve().is_relative_to(self.root):
            raise InputError(name[:200], "is no picture of this folder", "choose one of the list")
        if not path.is_file():
            raise InputError(name, "is no longer there", "choose another picture")
        return path


def checked_user(user: str) -> str:
    """The name of a user, which is part of file names; InputError where it cannot be."""
    if not USER.fullmatch(user):
        what = "is no name for a user"
        raise InputError(user[:40] or "user", what, "use 1 to 32 letters, digits, _ or -")
    return user


@dataclass
class Work:
    """What an event log holds, kept up to date event by event.

    head: the log's first line, written with the first event. events: all of them, each once.
    labels: uint8 (H,W), what they come to.
    """

    path: Path
    head: LogHead
    events: list[AnyEvent]
    labels: np.ndarray
    _lock: threading.RLock = field(default_factory=threading.RLock, repr=False)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the picture."""
        return self.head.height, self.head.width

    def add(self, event: AnyEvent) -> bool:
        """Take an event and have it on disk; False, and nothing done, for one that is there.

        Raises InputError for one that does not fit the picture, or cannot be written.
        """
        with self._lock:
            if any(event.id == one.id for one in self.events):
                return False
            if isinstance(event, Undo | Redo):
                labels = folded([*self.events, event], self.size)
            else:
                labels = self.labels.copy()
                apply_event(labels, event)
            append_event(self.path, self.head, event)
            self.events.append(event)
            self.labels = labels
            return True

    def standing(self) -> list[LastingEvent]:
        """The events that hold."""
        return standing(self.events)

    def taken_back(self) -> list[str]:
        """The events that can be done again: taken back last comes last, none after a new one."""
        stack: list[str] = []
        for event in self.events:
            if isinstance(event, Undo):
                stack = [*(one for one in stack if one != event.of), event.of]
            elif isinstance(event, Redo):
                stack = [one for one in stack if one != event.of]
            else:
                stack = []
        return stack

    @property
    def confirmed(self) -> bool:
        """Whether the person said that it is right as it is."""
        return any(isinstance(event, Confirm) for event in self.standing())

    @property
    def seconds(self) -> float:
        """At work on the picture."""
        return sum(event.seconds for event in self.events)


def open_work(path: Path, head: LogHead) -> Work:
    """The work in a log, or a new one with this head; DatasetError if it cannot be read."""
    log = (read_log(path) if path.exists() else None) or EventLog(path, head, ())
    return Work(path, log.head, list(log.events), log.labels())


# --- labels of other programs -----------------------------------------------------------


def import_labels(name: str, origin: Path, folder: Path, out: Path, user: str) -> int:
    """Add the labels of a format in ``origin`` to a user's logs; how many pictures had some.

    Raises InputError for a name that is none for a user, DatasetError for what cannot be read;
    then nothing was added.
    """
    checked_user(user)
    pictures = PictureFolder(folder, out)
    sizes = {one: picture_size(pictures.path(one)) for one in pictures.names()}
    found = FORMATS[name].read(origin, sizes)
    for picture, labels in found.items():
        height, width = sizes[picture]
        relative = os.path.relpath(pictures.root / picture, pictures.apart)
        head = LogHead(picture=relative, user=user, height=height, width=width)
        work = open_work(log_path(out, picture, user), head)
        if not work.events or (work.labels != labels).any():  # else they were brought in before
            work.add(import_event(labels, len(work.events)))
    return len(found)


def import_event(labels: np.ndarray, number: int = 0) -> Import:
    """The event of a number that makes labels uint8 (H,W) what they are here."""
    runs = {LABELS[one]: runs_of(labels == one) for one in np.unique(labels).tolist()}
    identity = hashlib.sha256(f"{number} {runs}".encode()).hexdigest()[:32]
    return Import(kind="brought", id=identity, time=round(time.time(), 3), labels=runs)
