"""Pictures: the files that names, folders, globs and URLs stand for."""

import hashlib
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path, PurePosixPath

from torch import Tensor

from roadtorch.base.atomic import digest_of
from roadtorch.base.errors import InputError, RoadtorchError
from roadtorch.base.image import READABLE, SUFFIXES, decode_image, read_image
from roadtorch.base.urls import (
    WEB,
    file_system,
    scheme_of,
    url_bytes,
    url_errors,
    without_password,
)
from roadtorch.inputs.files import files_at
from roadtorch.inputs.item import Item, Selection, Source

RESULTS = (".likelihood.png", ".mask.png", ".overlay.jpg")  # ours; never pictures to look at


def picture_item(origin: Path | str, name: str) -> Item:
    """A picture as an item of its own: a file of this machine, or, as text, a URL."""
    suffix = PurePosixPath(re.split(r"::|(?<=\w)[?#]", str(origin))[0]).suffix
    if isinstance(origin, Path):
        read, digest = partial(read_image, origin), partial(digest_of, origin)
        return Item(name, str(origin), read, digest, suffix, origin)
    return Item(
        name, origin, partial(_read_remote, origin), partial(_digest_remote, origin), suffix
    )


@lru_cache(maxsize=1)
def _remote_bytes(url: str) -> bytes:
    """What was fetched last is kept, so that a picture and its digest take one transfer."""
    return url_bytes(url)


def _read_remote(url: str) -> Tensor:
    return decode_image(_remote_bytes(url), without_password(url))


def _digest_remote(url: str) -> str:
    try:
        return hashlib.sha256(_remote_bytes(url)).hexdigest()
    except RoadtorchError:
        return ""


def _exists(picture: Item) -> bool:
    """Whether it is there; InputError or ConfigError for a URL that cannot be used."""
    if picture.file is not None:
        return picture.file.exists()
    if scheme_of(picture.origin) in WEB:
        return True  # the server has been asked
    system, path = file_system(picture.origin)
    with url_errors(picture.origin):
        return system.exists(path)


def find_pictures(
    inputs: Iterable[str | os.PathLike[str]], apart: Path | None = None
) -> list[Item]:
    """The pictures that files, folders, quoted globs and URLs stand for, in a settled order.

    Folders are searched with all that is below them, hidden names and earlier results
    left out, and so is the folder ``apart``, where new results go. A single missing
    file stays in the list, so that the others are not held up by it; reading it fails.

    Raises InputError, naming the input, for a folder or glob without pictures, and when
    nothing that was named exists; InputError or ConfigError for a URL that cannot be used.
    """
    pictures: list[Item] = []
    for given in inputs:
        pictures += (here := pictures_at(given, apart))
        if not here:
            raise InputError(given, "holds no pictures", f"give {READABLE} files")
    return each_once(pictures)


def each_once(pictures: Sequence[Item]) -> list[Item]:
    """The same pictures, none twice; InputError when there are some and none of them exists."""
    if pictures and not any(map(_exists, pictures)):
        raise InputError(pictures[0].origin, "does not exist", "check the name")
    return list(dict.fromkeys(pictures))


def pictures_at(given: str | os.PathLike[str], apart: Path | None = None) -> list[Item]:
    """The pictures of a folder or glob, none where it holds none; a single file is one as it is.

    Raises InputError or ConfigError for a URL that cannot be used.
    """
    files = files_at(given, names_picture, apart)
    return [
        picture_item(file.origin, PurePosixPath(file.name).with_suffix("").as_posix())
        for file in (files if isinstance(files, list) else [files])
    ]


def picture_source(given: str, selection: Selection) -> Source:
    """A picture file, folder, glob or URL as a source that does not move; errors as above."""
    pictures = [
        replace(picture, number=number) for number, picture in enumerate(find_pictures([given]))
    ]
    chosen = list(selection.of(pictures))
    name = Path(given).stem or "pictures"
    return Source(name, given, False, lambda: iter(chosen), count=len(chosen))


def names_picture(name: str) -> bool:
    """Whether a file of that name is a picture to look at: not hidden, no result of ours."""
    name = name.lower()
    is_ours = name.endswith(RESULTS) or ".cue." in name
    return name.endswith(SUFFIXES) and not name.startswith(".") and not is_ours
