"""Pictures behind the URLs of fsspec: ``s3://bucket/drive``, ``file:///footage/*.jpg``."""

import glob
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from roadtorch.errors import ConfigError, InputError
from roadtorch.io.image import READABLE
from roadtorch.sources.pictures import names_picture

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://|[A-Za-z][A-Za-z0-9+.-]+::")


@dataclass(frozen=True)
class RemotePicture:
    """A picture behind a URL and the name of its results: relative, no suffix."""

    url: str
    name: str


def is_url(text: str) -> bool:
    """Whether a text is a URL (or a chain of them, ``zip://…::s3://…``), not a path."""
    return _URL.match(text) is not None


@contextmanager
def told_of(url: str) -> Iterator[None]:
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

    Raises ConfigError where fsspec or the package for such URLs is not installed, InputError
    for a URL of no known kind.
    """
    with told_of(url):
        from fsspec.core import url_to_fs

        return url_to_fs(url)


def find_remote(inputs: Iterable[str]) -> list[RemotePicture]:
    """The pictures that URLs of files, folders and globs stand for, sorted within each of them.

    As ``find_images``: names keep sub-folders, and hidden files and earlier results are left
    out. Raises InputError for a folder or glob without pictures.
    """
    return list(dict.fromkeys(one for given in inputs for one in _behind(given)))


def _behind(given: str) -> list[RemotePicture]:
    system, path = file_system(given)
    with told_of(given):
        if glob.has_magic(path):
            root = PurePosixPath(*_before_wildcards(path))
            files = system.glob(path)
        elif system.isdir(path):
            root, files = PurePosixPath(path), system.find(path)
        else:
            return [RemotePicture(given, PurePosixPath(path).stem)]
        found = [path for path in map(PurePosixPath, sorted(files)) if names_picture(path.name)]
        shown = [path for path in found if not _is_hidden(path.relative_to(root))]
    if not shown:
        raise InputError(given, "holds no pictures", f"give {READABLE} files")
    return [
        RemotePicture(
            system.unstrip_protocol(str(file)), file.relative_to(root).with_suffix("").as_posix()
        )
        for file in shown
    ]


def _before_wildcards(path: str) -> Iterator[str]:
    for part in PurePosixPath(path).parts:
        if glob.has_magic(part):
            return
        yield part


def _is_hidden(path: PurePosixPath) -> bool:
    return any(part.startswith(".") for part in path.parts)


def read_remote(url: str) -> bytes:
    """The bytes behind a URL; InputError naming it when they cannot be had."""
    system, path = file_system(url)
    with told_of(url):
        return system.cat_file(path)
