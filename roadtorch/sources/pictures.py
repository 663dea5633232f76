"""Pictures: the files that names, folders, globs and URLs stand for."""

import os
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path, PurePosixPath

from PIL import Image
from torch import Tensor

from roadtorch.errors import InputError
from roadtorch.io.addresses import file_system, files_at, is_url, url_bytes, url_errors
from roadtorch.io.image import READABLE, SUFFIXES, read_image
from roadtorch.sources.frame import Frame, Selection, Source

LABEL = re.compile(r"[-_.]?(mask|label|labels|labelIds|gt|gtFine|road|seg)$", re.IGNORECASE)
"""What the names of labels end with beside those of their pictures."""

RESULTS = (".likelihood.png", ".mask.png", ".overlay.jpg")  # ours; never pictures to look at


@dataclass(frozen=True)
class Picture:
    """A picture and the name of its results: relative, sub-folders kept, no suffix.

    origin: its file on this machine, or its URL as text.
    """

    origin: Path | str
    name: str

    @property
    def is_remote(self) -> bool:
        """Whether it is behind a URL."""
        return isinstance(self.origin, str)

    @property
    def path(self) -> Path:
        """The file of a picture of this machine; InputError for one behind a URL."""
        if isinstance(self.origin, str):
            raise InputError(self.origin, "is not on this machine", "give files, not URLs")
        return self.origin

    @property
    def suffix(self) -> str:
        """How the name of its file ends."""
        return PurePosixPath(str(self.origin).partition("::")[0]).suffix

    def exists(self) -> bool:
        """Whether it is there; InputError or ConfigError for a URL that cannot be used."""
        if not isinstance(self.origin, str):
            return self.origin.exists()
        system, path = file_system(self.origin)
        with url_errors(self.origin):
            return system.exists(path)

    def data(self) -> bytes:
        """The bytes behind its URL or in its file, at most 1 GiB.

        Raises InputError naming it when they cannot be had.
        """
        here = self.origin
        return url_bytes(here if isinstance(here, str) else str(here.absolute()))

    def read(self) -> Tensor:
        """The image (3,H,W) in [0,1]; raises what ``read_image`` raises."""
        return read_image(self.origin)


def find_images(
    inputs: Iterable[str | os.PathLike[str]], apart: Path | None = None
) -> list[Picture]:
    """The pictures that files, folders, quoted globs and URLs stand for, in a settled order.

    Folders are searched with all that is below them, hidden names and earlier results
    left out, and so is the folder ``apart``, where new results go. A single missing
    file stays in the list, so that the others are not held up by it; reading it fails.

    Raises InputError, naming the input, for a folder or glob without pictures, and when
    nothing that was named exists; InputError or ConfigError for a URL that cannot be used.
    """
    found: list[Picture] = []
    for item in inputs:
        found += (here := pictures_at(item, apart))
        if not here:
            raise InputError(item, "holds no pictures", f"give {READABLE} files")
    return each_once(found)


def each_once(pictures: Sequence[Picture]) -> list[Picture]:
    """The same pictures, none twice; InputError when there are some and none of them exists."""
    if pictures and not any(picture.exists() for picture in pictures):
        raise InputError(pictures[0].origin, "does not exist", "check the name")
    return list(dict.fromkeys(pictures))


def label_and_picture(pictures: Iterable[Picture]) -> tuple[Picture, Picture] | None:
    """The first picture that looks like the label of another, and that one; None without any.

    It has the other's name, ``_mask`` or the like left out, and is a PNG of one channel.
    """
    namesakes: dict[str, list[Picture]] = {}
    for one in pictures:
        if not one.is_remote:
            namesakes.setdefault(LABEL.sub("", one.path.stem), []).append(one)
    for group in namesakes.values():
        for label, other in permutations(group, 2):
            if label.suffix.lower() == ".png":
                with suppress(OSError), Image.open(label.path) as header:
                    if header.mode in ("1", "L", "P"):
                        return label, other
    return None


def pictures_at(given: str | os.PathLike[str], apart: Path | None = None) -> list[Picture]:
    """The pictures of a folder or glob, none where it holds none; a single file is one as it is.

    Raises InputError or ConfigError for a URL that cannot be used.
    """
    given = os.fspath(given)
    files = files_at(given, names_picture, apart)
    if files is None:
        if is_url(given):
            return [Picture(given, PurePosixPath(file_system(given)[1]).stem)]
        return [Picture(Path(given), Path(given).stem)]
    return [
        Picture(one.origin, PurePosixPath(one.name).with_suffix("").as_posix()) for one in files
    ]


def picture_source(given: str, selection: Selection) -> Source:
    """A picture file, folder, glob or URL as a source that does not move; errors as above."""
    found = find_images([given])
    frames = [
        Frame(number, one.name, str(one.origin), None, one.read) for number, one in enumerate(found)
    ]
    chosen = list(selection.of(frames))
    name = Path(given).stem or "pictures"
    return Source(name, given, False, lambda: iter(chosen), count=len(chosen))


def names_picture(name: str) -> bool:
    """Whether a file of that name is a picture to look at: not hidden, no result of ours."""
    name = name.lower()
    is_ours = name.endswith(RESULTS) or ".cue." in name
    return name.endswith(SUFFIXES) and not name.startswith(".") and not is_ours
