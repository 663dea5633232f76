"""The folder of pictures that is corrected: what is in it now, and nothing outside it."""

import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from roadtorch.data.labels import is_picture
from roadtorch.errors import InputError
from roadtorch.io.bounded import printable
from roadtorch.sources.pictures import find_images

FRESH = 2.0  # seconds for which a listing holds


@dataclass
class PictureFolder:
    """The pictures below ``root``, by their relative name with ending; ``apart`` is left out."""

    root: Path
    apart: Path
    _names: tuple[str, ...] = ()
    _listed: float = field(default=-FRESH, repr=False)
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
                self._listed = time.monotonic()
            return self._names

    def path(self, name: str) -> Path:
        """The file of a name that came from outside.

        Raises InputError for one that leads out of the folder, is no picture, or is gone.
        """
        path = (self.root / name).resolve() if "\0" not in name else self.root
        if not path.is_relative_to(self.root) or not is_picture(path):
            raise InputError(name[:200], "is no picture of this folder", "choose one of the list")
        if not path.is_file():
            raise InputError(name, "is no longer there", "choose another picture")
        return path
