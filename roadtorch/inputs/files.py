"""What an address stands for: a file, folder or glob, of this machine or behind a URL of fsspec.

``s3://bucket/drive``, ``file:///footage/*.jpg`` and ``footage/*.jpg`` mean the same: folders with
all that is below them, globs with what they match. Files of this machine are listed without
fsspec: it makes paths absolute, follows links without end, and asks for the state of every file.
"""

import glob
import os
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from itertools import takewhile
from os.path import basename
from pathlib import Path
from typing import NamedTuple

from roadtorch.base.urls import file_system, is_url, url_errors


class File(NamedTuple):
    """A file: its path on this machine or its URL, and its name, relative, with ending."""

    origin: Path | str
    name: str


Wanted = Callable[[str], bool]
"""Whether a file is asked for, by its name without folders."""


def files_at(
    given: str | os.PathLike[str], wanted: Wanted, apart: Path | None = None
) -> list[File] | File:
    """The wanted files of a folder or glob, in a settled order; a single file as it is.

    Folders are searched with all that is below them, hidden ones left out, and so is the folder
    ``apart``. A glob stands for the files that it matches, or, without wanted ones among them,
    for the folders. Names are relative to the folder, or to the one before the first wildcard.

    Raises InputError or ConfigError for a URL that cannot be used.
    """
    path = os.fspath(given)
    remote = is_url(path)
    if remote:
        system, path = file_system(path)
    else:
        system = _Local(apart)
    with url_errors(os.fspath(given)) if remote else nullcontext():
        if glob.has_magic(path) and not system.exists(path):
            fixed = takewhile(lambda part: not glob.has_magic(part), Path(path).parts)
            root, matches = Path(*fixed), sorted(system.glob(path, detail=True).items())
            is_folder = {path: about["type"] == "directory" for path, about in matches}
            files = [path for path in is_folder if not is_folder[path] and wanted(basename(path))]
            folders = [path for path in is_folder if is_folder[path] and not files]
        elif system.isdir(path):
            root, files, folders = Path(path), [], [path]
        else:
            return File(os.fspath(given) if remote else Path(path), basename(path))
        for top in folders:
            below = sorted(system.find(top)) if remote else system.find(top)
            files += [path for path in below if wanted(basename(path))]
        named = [(path, Path(path).relative_to(root)) for path in dict.fromkeys(files)]
        return [
            File(system.unstrip_protocol(path), name.as_posix())
            for path, name in named
            if not (remote and any(part[0] == "." for part in name.parts))
        ]


class _Local:
    """The files of this machine, asked for as those of a file system of fsspec; apart: left out."""

    exists, isdir = staticmethod(os.path.exists), staticmethod(os.path.isdir)
    unstrip_protocol = Path

    def __init__(self, apart: Path | None) -> None:
        # Path.resolve raises for a link to itself, which is a file like any other here.
        self._apart = os.path.realpath(apart) if apart else None

    def glob(self, pattern: str, **_: object) -> dict[str, dict[str, str]]:
        """What a glob matches, and whether it is a directory."""
        kinds = {"directory": os.path.isdir, "file": os.path.isfile}
        paths = glob.glob(pattern, recursive=True)
        return {
            path: {"type": kind} for kind, fits in kinds.items() for path in paths if fits(path)
        }

    def find(self, folder: str) -> Iterator[str]:
        """Every file below a folder but hidden folders and ``apart``, sorted, folder by folder."""
        apart = None if self._apart == os.path.realpath(folder) else self._apart
        for top, folders, names in os.walk(folder):
            folders[:] = sorted(
                name
                for name in folders
                if name[0] != "." and os.path.realpath(os.path.join(top, name)) != apart
            )
            yield from (os.path.join(top, name) for name in sorted(names))
