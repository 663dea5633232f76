"""What an address stands for: a file, folder or glob, of this machine or behind a URL of fsspec.

``s3://bucket/drive``, ``file:///footage/*.jpg`` and ``footage/*.jpg`` mean the same: folders with
all that is below them, globs with what they match. Files of this machine are listed without
fsspec: it makes paths absolute, follows links without end, and asks for the state of every file.
"""

import glob
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from itertools import takewhile
from os.path import basename
from pathlib import Path
from typing import Any, NamedTuple

from roadtorch.errors import ConfigError, InputError, unknown_name
from roadtorch.io.bounded import MAX_BYTES

STREAMS = ("http", "https", "rtsp", "rtsps", "rtmp", "rtmps", "rtp", "srt", "tcp", "udp", "mms")
"""Schemes of URLs that are read as video streams."""

# --- URLs -------------------------------------------------------------------------------


def scheme_of(given: str) -> str:
    """The scheme of a URL, or of the first of a chain (``zip://…::s3://…``); empty for a path."""
    found = re.match(r"([A-Za-z][A-Za-z0-9+._-]+)(://|::)", given)
    return found[1].lower() if found else ""


def is_url(given: str) -> bool:
    """Whether a text is a URL, not a path."""
    return scheme_of(given) != ""


def without_password(url: str) -> str:
    """An address for messages and files: without the name and password of a user."""
    return re.sub(r"(?<=://)[^/@]*@", "", url)


@contextmanager
def url_errors(url: str) -> Iterator[None]:
    """What goes wrong within the block in words that name the URL.

    Raises ConfigError where a package is missing for such URLs, else InputError.
    """
    try:
        yield
    except ImportError as problem:
        what = f"cannot be reached: {' '.join(str(problem).split())}"
        raise ConfigError(url, what, "install that package") from None
    except FileNotFoundError:
        raise InputError(url, "does not exist", "check the name") from None
    except (OSError, ValueError) as problem:
        what = f"cannot be used: {' '.join(str(problem).split()) or type(problem).__name__}"
        raise InputError(url, what, "check the URL and the access to it") from None


def file_system(url: str) -> tuple[Any, str]:
    """The file system of fsspec behind a URL or path, and the path in it.

    Raises ConfigError for a URL of no known kind, with near ones, and where fsspec or the package
    for such URLs is not installed.
    """
    with url_errors(url):
        from fsspec import available_protocols
        from fsspec.core import url_to_fs

        if (scheme := scheme_of(url)) and scheme not in available_protocols():
            raise unknown_name("kind of URL", scheme, available_protocols())
        return url_to_fs(url)


def url_bytes(url: str) -> bytes:
    """The bytes of the file behind a URL or path, at most 1 GiB.

    Raises InputError naming it when they cannot be had.
    """
    system, path = file_system(url)
    with url_errors(url):
        data = system.cat_file(path, end=MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InputError(url, f"has more than {MAX_BYTES:,} bytes", "make it smaller")
    return data


# --- files ------------------------------------------------------------------------------


class File(NamedTuple):
    """A file: its path on this machine or its URL, and its name, relative, with ending."""

    origin: Path | str
    name: str


Wanted = Callable[[str], bool]
"""Whether a file is asked for, by its name without folders."""


def files_at(
    given: str | os.PathLike[str], wanted: Wanted, apart: Path | None = None
) -> list[File] | None:
    """The wanted files of a folder or glob, in a settled order; None for a single file.

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
            is_folder = {one: about["type"] == "directory" for one, about in matches}
            found = [one for one in is_folder if not is_folder[one] and wanted(basename(one))]
            folders = [one for one in is_folder if is_folder[one] and not found]
        elif system.isdir(path):
            root, found, folders = Path(path), [], [path]
        else:
            return None
        for top in folders:
            below = sorted(system.find(top)) if remote else system.find(top)
            found += [one for one in below if wanted(basename(one))]
        named = [(one, Path(one).relative_to(root)) for one in dict.fromkeys(found)]
        return [
            File(system.unstrip_protocol(one), name.as_posix())
            for one, name in named
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
        found = glob.glob(pattern, recursive=True)
        return {one: {"type": kind} for kind, fits in kinds.items() for one in found if fits(one)}

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
