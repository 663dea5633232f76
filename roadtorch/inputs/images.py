"""Files found by names, folders and globs, the images among them, and images fetched over HTTP."""

import glob
import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache, partial
from itertools import takewhile
from os.path import basename, dirname
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from urllib.parse import urlsplit

from torch import Tensor

from roadtorch.base.atomic import file_digest
from roadtorch.base.bounded import strip_password, strip_user
from roadtorch.base.decoding import is_image_start
from roadtorch.base.errors import InputError, RoadtorchError
from roadtorch.base.image import (
    IMAGE_SUFFIXES,
    READABLE_FORMATS,
    UNREAD_SUFFIXES,
    decode_image,
    read_image,
    warn_of_unread,
)
from roadtorch.base.urls import open_url, read_chunks, read_url, slug, url_scheme
from roadtorch.inputs.item import Item

IMAGE_START = 16  # bytes by which the formats are told apart

RESULT_SUFFIXES = (".likelihood.png", ".mask.png", ".overlay.jpg")  # our results, never inputs


class ListedFile(NamedTuple):
    """A file: its path, and its relative name with suffix."""

    path: Path
    name: str

    @property
    def stem(self) -> str:
        """Relative name without suffix."""
        return PurePosixPath(self.name).with_suffix("").as_posix()


def list_files(
    location: str | os.PathLike[str], accepts: Callable[[str], bool], exclude: Path | None = None
) -> list[ListedFile]:
    """Return the matching files of a folder or glob in a fixed order; a single file as it is.

    Folders are searched recursively except for hidden ones and ``exclude``. A glob stands for the
    files that it matches or, if none of them is wanted, for the folders. Names are relative to the
    folder, or to the part of the glob before its first wildcard. InputError for a URL.
    """
    path = os.fspath(location)
    if not path:
        raise InputError("''", "is an empty name", "give a file or a folder")
    if url_scheme(path):
        raise InputError(path, "cannot be read from a URL", "download it, or mount it")
    if glob.has_magic(path) and not os.path.exists(path):
        root = Path(*takewhile(lambda part: not glob.has_magic(part), Path(path).parts))
        paths = sorted(glob.glob(path, recursive=True), key=lambda match: -match.count(os.sep))
        # A link to a folder around it shows each file again, at a longer path.
        unique = {
            os.path.join(os.path.realpath(dirname(match)), basename(match)): match
            for match in paths
        }
        matches = {match: os.path.isdir(match) for match in sorted(unique.values())}
        files = [match for match in matches if not matches[match] and accepts(basename(match))]
        folders = [match for match in matches if matches[match] and not files]
    elif os.path.isdir(path):
        root, files, folders = Path(path), [], [path]
    else:
        return [ListedFile(Path(path), Path(path).name)]
    for folder in folders:
        below = list(_files_below(folder, exclude))
        files += [file for file in below if accepts(basename(file))]
        unread = [file for file in below if file.lower().endswith((os.sep, *UNREAD_SUFFIXES))]
        warn_of_unread(folder, [os.path.relpath(file, folder) for file in unread])
    paths = map(Path, dict.fromkeys(files))
    return [ListedFile(path, path.relative_to(root).as_posix()) for path in paths]


def _files_below(folder: str, exclude: Path | None) -> Iterator[str]:
    """Yield the files below a folder, sorted, and links to folders elsewhere, which end in a /.

    Hidden folders and ``exclude`` are left out.
    """
    # Path.resolve raises for a link to itself.
    left_out, root = os.path.realpath(exclude) if exclude else None, os.path.realpath(folder)
    if left_out == root:
        left_out = None
    for top, folders, names in os.walk(folder):
        folders[:] = sorted(
            name
            for name in folders
            if name[0] != "." and os.path.realpath(os.path.join(top, name)) != left_out
        )
        links = [link for name in folders if os.path.islink(link := os.path.join(top, name))]
        for link, target in zip(links, map(os.path.realpath, links), strict=True):
            if os.path.commonpath([target, root]) not in (target, root):
                yield link + os.sep
        yield from (os.path.join(top, name) for name in sorted(names))


def is_image_name(name: str) -> bool:
    """Return whether a file name is that of an image: not hidden, no result of roadtorch."""
    name = name.lower()
    is_ours = name.endswith(RESULT_SUFFIXES) or ".cue." in name
    return name.endswith(IMAGE_SUFFIXES) and not name.startswith(".") and not is_ours


def make_image_item(file: ListedFile) -> Item:
    """Make an item of an image file."""
    path, read, digest = file.path, partial(read_image, file.path), partial(file_digest, file.path)
    return Item(file.stem, str(path), read, digest, path.suffix, path)


# --- images over HTTP -------------------------------------------------------------------


def open_web_image(url: str) -> Item | None:
    """Return the image at a URL; None where the server sends something else.

    An image is one by its name, by the server's word or by its first bytes. A server's stream of
    images (``multipart/…``) is none. Raises InputError where there is no answer and the name is an
    image's; other URLs may be streams, which are waited for.
    """
    path = PurePosixPath(urlsplit(strip_user(url)).path)
    name, is_named = slug(path.with_suffix("").as_posix()), is_image_name(path.name)
    try:
        with open_url(url) as response:
            kind = response.headers.get_content_maintype()
            if not is_named and kind not in ("image", "multipart", "video"):
                is_named = is_image_start(next(read_chunks(response, IMAGE_START), b""))
    except InputError:
        if is_named:
            raise
        return None
    if kind != "image" and (not is_named or kind == "multipart"):
        return None
    origin = strip_password(url)
    return Item(name, origin, partial(_read_remote, url), partial(_digest_remote, url), path.suffix)


@lru_cache(maxsize=1)
def _remote_bytes(url: str) -> bytes:
    """Download an image; the last one is cached, so that reading and hashing take one transfer."""
    return read_url(url)


def _read_remote(url: str) -> Tensor:
    return decode_image(_remote_bytes(url), strip_password(url))


def _digest_remote(url: str) -> str:
    try:
        return hashlib.sha256(_remote_bytes(url)).hexdigest()
    except RoadtorchError:
        return ""


# --- several images ---------------------------------------------------------------------


def find_images(
    inputs: Iterable[str | os.PathLike[str]], exclude: Path | None = None
) -> list[Item]:
    """Return the images that files, folders and quoted globs stand for, in a fixed order.

    Folders are searched recursively except for hidden names, earlier results and the folder
    ``exclude``, where new results go. A missing file stays in the list, as reading it fails
    without holding up the others.

    Raises:
        InputError: for a folder or glob without images, and if none of the files exists.
    """
    images: list[Item] = []
    for location in inputs:
        files = list_files(location, is_image_name, exclude)
        if not files:
            raise InputError(location, "holds no images", f"give {READABLE_FORMATS} files")
        images += map(make_image_item, files)
    return drop_duplicates(images)


def drop_duplicates(images: Sequence[Item]) -> list[Item]:
    """Drop repeated images; InputError if none of them exists."""
    if images and not any(item.file is None or item.file.exists() for item in images):
        raise InputError(images[0].origin, "does not exist", "check the name")
    return list(dict.fromkeys(images))
