"""The folder of pictures that is corrected, and the logs of people's work on them."""

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
from roadtorch.data.event_log import EventLog, LogHead, log_path, read_log
from roadtorch.data.events import Import, runs_of
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


def open_work(
    pictures: PictureFolder, out: Path, name: str, user: str, size: tuple[int, int]
) -> EventLog:
    """A user's log for a picture of (height, width), or a new one.

    Raises InputError for a name that is none for a user, DatasetError for a log that cannot be
    read or does not fit its picture.
    """
    path = log_path(out, name, checked_user(user))
    log = read_log(path) if path.exists() else None
    if log is None:
        picture = os.path.relpath(pictures.root / name, pictures.apart)
        log = EventLog(path, LogHead(picture=picture, user=user, height=size[0], width=size[1]))
    log.labels  # noqa: B018  # folded before other threads see it
    return log


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
        work = open_work(pictures, out, picture, user, sizes[picture])
        if not work.events or (work.labels != labels).any():  # else they were brought in before
            work.add(import_event(labels, len(work.events)))
    return len(found)


def import_event(labels: np.ndarray, number: int = 0) -> Import:
    """The event of a number that makes labels uint8 (H,W) what they are here."""
    runs = {LABELS[one]: runs_of(labels == one) for one in np.unique(labels).tolist()}
    identity = hashlib.sha256(f"{number} {runs}".encode()).hexdigest()[:32]
    return Import(kind="brought", id=identity, time=round(time.time(), 3), labels=runs)
