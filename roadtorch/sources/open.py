"""What the inputs of a command stand for: pictures, and sources that give frame after frame."""

import glob
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from roadtorch.errors import ConfigError, InputError
from roadtorch.sources.archives import archive_source, is_archive, is_remote
from roadtorch.sources.bags import bag_source, is_bag
from roadtorch.sources.frame import Selection, Source
from roadtorch.sources.live import Patience, camera_source, stream_source, without_password
from roadtorch.sources.pictures import has_pictures, picture_source, walk_files
from roadtorch.sources.video import VIDEO_SUFFIXES, is_video, video_source

CAMERA = re.compile(r"(?:camera:)?(\d+)")
"""A camera's number; a file of that name goes before ``0``, never before ``camera:0``."""

STREAM = re.compile(r"(rtsps?|rtmps?|https?|udp|srt|tcp)://", re.IGNORECASE)

WHOLE = re.compile(
    r"https?://[^?#]*\.(mp4|m4v|mov|avi|mkv|webm|mpe?g|wmv|flv)([?#].*)?$", re.IGNORECASE
)
"""The address of a video that is read to its end, every frame, not of a stream."""


@dataclass(frozen=True)
class Inputs:
    """Inputs by how they are worked through: as pictures that stand alone, or frame by frame."""

    pictures: list[str]
    sources: list[str]


def sort_inputs(inputs: Iterable[str], names: TextIO | None = None) -> Inputs:
    """The inputs with their lists read; what holds both pictures and videos stands in both.

    names: what ``-`` reads, standard input where it is None. Raises InputError for a list that
    cannot be read.
    """
    pictures, sources, inputs = [], [], list(inputs)
    for given in named(inputs, sys.stdin if names is None else names):
        if _is_source(given):
            sources.append(given)
            continue
        videos = video_files(given)
        sources += [given] if videos else []
        pictures += [given] if not videos or has_pictures(given) else []
    if inputs and not pictures and not sources:
        raise InputError(inputs[0], "names nothing", "give names, one a line")
    return Inputs(pictures, sources)


def named(inputs: Iterable[str], names: TextIO) -> Iterator[str]:
    """The inputs, with ``-`` and ``@list.txt`` replaced by the lines that they hold.

    Empty lines are left out. A file named ``-`` or ``@…`` is given as ``./-``.
    """
    for given in inputs:
        if given == "-":
            yield from _lines(names)
        elif given.startswith("@"):
            try:
                with open(given[1:], encoding="utf-8", errors="surrogateescape") as file:
                    yield from _lines(file)
            except OSError as problem:
                what = f"cannot be read: {problem.strerror}"
                raise InputError(given[1:], what, "give @ and a text file, a name a line") from None
        else:
            yield given


def _lines(file: Iterable[str]) -> Iterator[str]:
    return (name for line in file if (name := line.rstrip("\r\n")).strip())


def _is_source(given: str) -> bool:
    """Whether an input is one source by itself, whatever it holds."""
    if camera_number(given) is not None or STREAM.match(given):
        return True
    if is_bag(given) or is_archive(given):
        return True
    is_many = Path(given).is_dir() or glob.has_magic(given)
    return given.lower().endswith(VIDEO_SUFFIXES) and not (is_many and not Path(given).is_file())


def camera_number(given: str) -> int | None:
    """The number of the camera that an input names; None where it names none."""
    found = CAMERA.fullmatch(given)
    if found is None or (given.isdigit() and Path(given).exists()):
        return None
    return int(found[1])


@dataclass(frozen=True)
class Told:
    """What else sources are told, each kind something of its own.

    apart: a folder that is left out where folders are searched, that of the results. patience:
    with live sources. topic: of the images in bags; None where they have one.
    """

    apart: Path | None = None
    patience: Patience = field(default_factory=Patience)
    topic: str | None = None


def open_source(given: str, selection: Selection, told: Told = Told()) -> Source:
    """The one source that an input stands for; pictures are one that does not move.

    Raises InputError for what is not there, ConfigError for an input of several sources.
    """
    if is_remote(given):
        return archive_source(given, selection)
    sorted_inputs = sort_inputs([given])
    if not sorted_inputs.sources:
        return picture_source(given, selection)
    sources = open_sources(sorted_inputs.sources, selection, told)
    if len(sources) != 1 or sorted_inputs.pictures:
        what = f"holds {len(sources)} videos" + (" and pictures" * bool(sorted_inputs.pictures))
        raise ConfigError(given, what, "give one of them")
    return sources[0]


def open_sources(
    inputs: Sequence[str],
    selection: Selection,
    told: Told = Told(),
) -> list[Source]:
    """The sources that inputs of ``sort_inputs(…).sources`` stand for, in their order.

    Raises InputError for what cannot be opened, ConfigError when two would share their results.
    """
    sources = [source for given in inputs for source in _opened(given, selection, told)]
    owners: dict[str, Source] = {}
    for source in sources:
        other = owners.setdefault(source.name, source)
        if other is not source:
            what = f"both would write {source.name}"
            where = f"{other.origin} and {source.origin}"
            raise ConfigError(where, what, "rename one, or use two --out folders")
    return sources


def _opened(given: str, selection: Selection, told: Told) -> Iterator[Source]:
    number = camera_number(given)
    if number is not None:
        yield camera_source(number, selection, told.patience)
    elif WHOLE.match(given):
        yield video_source(given, slug(given), selection)
    elif STREAM.match(given):
        yield stream_source(given, slug(given), selection, told.patience)
    elif is_bag(given):
        yield bag_source(given, told.topic, selection)
    elif is_archive(given):
        yield archive_source(given, selection)
    else:
        yield from _videos(given, selection, told.apart)


def _videos(given: str, selection: Selection, apart: Path | None) -> Iterator[Source]:
    for path, name in video_files(given, apart):
        yield video_source(path, name, selection)


def slug(url: str) -> str:
    """A name for the results of an address: what stands between its signs, without a password."""
    address = re.sub(r"^\w+://|[?#].*", "", without_password(url))
    return re.sub(r"[^\w.]+", "-", address).strip("-.") or "stream"


def video_files(given: str, apart: Path | None = None) -> list[tuple[Path, str]]:
    """The video files of a name, folder or glob, with the names of their results."""
    path = Path(given)
    if path.is_dir():
        found = [(file, path) for file in walk_files(path, apart, is_video)]
    elif not path.exists() and glob.has_magic(given):
        found = list(_globbed(given))
    else:
        named_so = path.name.lower().endswith(VIDEO_SUFFIXES)
        return [(path, path.stem)] if named_so else []
    return [(file, file.relative_to(root).with_suffix("").as_posix()) for file, root in found]


def _globbed(pattern: str) -> Iterator[tuple[Path, Path]]:
    """The video files of a glob, each with the folder before the first wildcard."""
    parts = Path(pattern).parts
    magic = next(at for at, part in enumerate(parts) if glob.has_magic(part))
    for name in sorted(glob.glob(pattern, recursive=True)):
        if is_video(Path(name)) and Path(name).is_file():
            yield Path(name), Path(*parts[:magic])
