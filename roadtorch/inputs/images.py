"""Files found by names, folders and globs, the images among them, and images fetched over HTTP."""

import glob
import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache, partial
from itertools import takewhile
from os.path import basename, dirname
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from urllib.parse import urlsplit

from roadtorch.base.atomic import file_digest, make_result_filter
from roadtorch.base.bounded import strip_password, strip_user
from roadtorch.base.decoding import is_image_start
from roadtorch.base.errors import InputError, RoadtorchError
from roadtorch.base.image import (
    IMAGE_SUFFIXES,
    READABLE_FORMATS,
    read_file,
    read_image,
    warn_of_unread,
)
from roadtorch.base.urls import open_url, read_chunks, read_url, slug, url_scheme
from roadtorch.inputs.bags import listed_recordings
from roadtorch.inputs.item import Item

IMAGE_START = 16  # bytes by which the formats are told apart

RESULT_SUFFIXES = (
    *(".likelihood.png", ".mask.png", ".overlay.jpg", ".grid.jpg"),
    *(".overlay.mp4", ".mask.mp4", ".likelihood.mp4"),
)
"""Results of roadtorch, never inputs, wherever they lie; others are known by a ledger."""

SIDE_FILES = re.compile(
    r".*\.(txt|csv|jsonl?|xml|ya?ml|toml|md|html|log|ini|np[yz]|py|xmp|srt|gpx|db|svg|pdf|pt|safetensors)"
)
"""Files beside images that hold no images."""


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
    files that it matches or, if none of them is wanted, for the folders. Results of roadtorch are
    left out; what else might hold images is reported. A folder that ``accepts`` is one file: a bag.
    Names are relative to the folder, or to the part of the glob before its first wildcard.
    InputError for a URL, and where there is none.
    """
    path = os.fspath(location)
    if not path:
        raise InputError("''", "is an empty name", "give a file or a folder")
    if url_scheme(path):
        raise InputError(path, "cannot be read from a URL", "download it, or mount it")
    is_result = make_result_filter()

    def is_wanted(file: str) -> bool:
        """Return whether neither a file nor a folder between it and the root is a result."""
        below = takewhile(lambda part: part != root, (Path(file), *Path(file).parents))
        return not any(is_result(str(part)) for part in below)

    if glob.has_magic(path) and not os.path.exists(path):
        root = Path(*takewhile(lambda part: not glob.has_magic(part), Path(path).parts))
        paths = sorted(glob.glob(path, recursive=True), key=lambda match: -match.count(os.sep))
        # A link to a folder around it shows each file again, at a longer path.
        unique = {
            os.path.join(os.path.realpath(dirname(match)), basename(match)): match
            for match in paths
        }
        matches = {match: os.path.isdir(match) for match in sorted(unique.values())}
        files = [match for match in matches if not matches[match] and accepts(match)]
        files = list(filter(is_wanted, files))
        folders = [match for match in matches if matches[match] and not files]
    elif os.path.isdir(path):
        root, files, folders = Path(path), [], [str(Path(path))]
    else:
        return [ListedFile(Path(path), Path(path).name)]
    for folder in folders:
        below = list(filter(is_wanted, _files_below(folder, exclude)))
        files += [file for file in below if accepts(file)]
        unread = [os.path.relpath(file, folder) for file in below if may_be_footage(file)]
        names = {os.path.relpath(file, folder) for file in files}
        warn_of_unread(folder, [name for name in unread if name not in names])
    if not files:
        raise InputError(path, "holds no images", f"give {READABLE_FORMATS} files")
    paths = map(Path, dict.fromkeys(files))
    return [ListedFile(path, path.relative_to(root).as_posix()) for path in paths]


def may_be_footage(path: str) -> bool:
    """Return whether a file that exists may hold images: it is not hidden, no result, no text."""
    name = basename(path.rstrip(os.sep)).lower()
    is_other = name.startswith(".") or is_result_name(name) or bool(SIDE_FILES.fullmatch(name))
    return not is_other and os.path.exists(path)


def _files_below(folder: str, exclude: Path | None) -> Iterator[str]:
    """Yield the files below a folder, sorted, bags, and links to folders elsewhere with a / at end.

    Hidden folders and ``exclude`` are left out, and the files of a bag that is a folder.
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
        recordings = listed_recordings(top)
        if recordings:
            yield top
        yield from (os.path.join(top, name) for name in sorted({*names} - recordings))


def is_result_name(name: str) -> bool:
    """Return whether a lower-case file name is that of a result of roadtorch."""
    return name.endswith(RESULT_SUFFIXES) or ".cue." in name


def is_image_name(name: str) -> bool:
    """Return whether a path's name is that of an image: not hidden, no result of roadtorch."""
    name = basename(name).lower()
    return name.endswith(IMAGE_SUFFIXES) and name[0] != "." and not is_result_name(name)


def make_image_item(file: ListedFile) -> Item:
    """Make an item of an image file."""
    path = file.path
    read, digest, load = (
        partial(read_image, path),
        partial(file_digest, path),
        partial(read_file, path),
    )
    return Item(file.stem, str(path), read, digest, path.suffix, path, load=load)


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
            media_type = response.headers.get_content_maintype()
            if not is_named and media_type not in ("image", "multipart", "video"):
                is_named = is_image_start(next(read_chunks(response, IMAGE_START), b""))
    except InputError:
        if is_named:
            raise
        return None
    if media_type != "image" and (not is_named or media_type == "multipart"):
        return None
    parts = partial(read_image, url), partial(_digest_remote, url), path.suffix
    return Item(name, strip_password(url), *parts, load=partial(read_url, url))


def _digest_remote(url: str, data: bytes | None = None) -> str:
    with suppress(RoadtorchError):
        return hashlib.sha256(read_url(url) if data is None else data).hexdigest()
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
    files = [file for location in inputs for file in list_files(location, is_image_name, exclude)]
    return drop_duplicates([*map(make_image_item, files)])


def drop_duplicates(images: Sequence[Item]) -> list[Item]:
    """Drop repeated images, by folder and file name; InputError if none of them exists."""
    if images and not any(item.file is None or item.file.exists() for item in images):
        raise InputError(images[0].origin, "does not exist", "check the name")
    real_folder, once = cache(os.path.realpath), dict[object, Item]()
    for item in images:
        file = item.file and (real_folder(item.file.parent), item.file.name)
        once.setdefault(file or item, item)
    return [*once.values()]
