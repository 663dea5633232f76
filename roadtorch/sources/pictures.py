"""Pictures on disk: the files that names, folders and globs stand for."""

import glob
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from roadtorch.errors import InputError
from roadtorch.io.image import READABLE, SUFFIXES, read_image
from roadtorch.sources.frame import Frame, Selection, Source

RESULTS = (".likelihood.png", ".mask.png", ".overlay.jpg")  # ours; never pictures to look at

# --- finding ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Picture:
    """A picture file and the name of its results: relative, sub-folders kept, no suffix."""

    path: Path
    name: str


def find_images(
    inputs: Iterable[str | os.PathLike[str]], apart: Path | None = None
) -> list[Picture]:
    """The pictures that files, folders and quoted globs stand for, in a settled order.

    Folders are searched with all that is below them, hidden names and earlier results
    left out, and so is the folder ``apart``, where new results go. A single missing
    file stays in the list, so that the others are not held up by it; reading it fails.

    Raises InputError, naming the input, for a folder or glob without pictures, and when
    nothing that was named exists.
    """
    given = [Path(item) for item in inputs]
    found = [picture for item in given for picture in _expand(item, apart)]
    if given and not any(picture.path.exists() for picture in found):
        raise InputError(given[0], "does not exist", "check the name")
    return list(dict.fromkeys(found))


def has_pictures(given: str | os.PathLike[str]) -> bool:
    """Whether a file, folder or glob stands for a picture; a single file always does."""
    item = Path(given)
    if item.is_dir():
        return next(walk_files(item, None, _is_picture), None) is not None
    if not item.exists() and glob.has_magic(str(item)):
        return bool(_expand_glob(item, None))
    return True


def picture_source(given: str, selection: Selection) -> Source:
    """A picture file, folder or glob as a source that does not move; InputError as above."""
    found = find_images([given])
    frames = [
        Frame(number, one.name, str(one.path), None, partial(read_image, one.path))
        for number, one in enumerate(found)
    ]
    chosen = list(selection.of(frames))
    name = Path(given).stem or "pictures"
    return Source(name, given, False, lambda: iter(chosen), count=len(chosen))


def _expand(item: Path, apart: Path | None) -> list[Picture]:
    if item.is_dir():
        found = [
            Picture(path, _relative(path, item)) for path in walk_files(item, apart, _is_picture)
        ]
    elif not item.exists() and glob.has_magic(str(item)):
        found = _expand_glob(item, apart)
    else:
        return [Picture(item, item.stem)]
    if not found:
        raise InputError(item, "holds no pictures", f"give {READABLE} files")
    return found


def _expand_glob(pattern: Path, apart: Path | None) -> list[Picture]:
    """The glob's files, and its folders as if each had been given."""
    root = Path(*_before_magic(pattern))
    found: list[Picture] = []
    for path in map(Path, sorted(glob.glob(str(pattern), recursive=True))):
        if path.is_file() and _is_picture(path):
            found.append(Picture(path, _relative(path, root)))
    if not found:
        folders = [path for path in map(Path, sorted(glob.glob(str(pattern)))) if path.is_dir()]
        walked = [path for folder in folders for path in walk_files(folder, apart, _is_picture)]
        found = [Picture(path, _relative(path, root)) for path in walked]
    return found


def _before_magic(pattern: Path) -> Iterator[str]:
    for part in pattern.parts:
        if glob.has_magic(part):
            return
        yield part


def walk_files(folder: Path, apart: Path | None, wanted: Callable[[Path], bool]) -> Iterator[Path]:
    """Every wanted file below a folder, sorted by name, folder by folder.

    Hidden folders are left out, and so is ``apart``.
    """
    # Path.resolve raises for a link to itself, which is a file like any other here.
    other = os.path.realpath(apart) if apart else None
    other = None if other == os.path.realpath(folder) else other
    for top, folders, files in os.walk(folder):
        here = Path(top)
        folders[:] = sorted(
            name for name in folders if name[0] != "." and os.path.realpath(here / name) != other
        )
        yield from (here / name for name in sorted(files) if wanted(here / name))


def _is_picture(path: Path) -> bool:
    return names_picture(path.name)


def names_picture(name: str) -> bool:
    """Whether a file of that name is a picture to look at: not hidden, no result of ours."""
    name = name.lower()
    is_ours = name.endswith(RESULTS) or ".cue." in name
    return name.endswith(SUFFIXES) and not name.startswith(".") and not is_ours


def _relative(path: Path, root: Path) -> str:
    return path.relative_to(root).with_suffix("").as_posix()
