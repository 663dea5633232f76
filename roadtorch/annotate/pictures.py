"""The folder of pictures that is corrected: what is in it now, and nothing outside it."""

import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from roadtorch.data.labels import is_picture
from roadtorch.errors import InputError
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
                self._names = tuple(self._look())
                self._listed = time.monotonic()
            return self._names

    def _look(self) -> list[str]:
        try:
            found = find_images([self.root], self.apart)
        except InputError:  # emptied while the page is open
            return []
        return [name for one in found if (name := self._name(one.path)) is not None]

    def _name(self, path: Path) -> str | None:
        """The relative name; None for one that is no text, or leads outside."""
        name = path.relative_to(self.root).as_posix()
        try:
            name.encode()
        except UnicodeEncodeError:
            return None
        return name if path.resolve().is_relative_to(self.root) else None

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
