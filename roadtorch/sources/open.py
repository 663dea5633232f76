"""What the inputs of a command stand for: pictures, and sources that give frame after frame."""

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import groupby, islice
from pathlib import Path
from typing import NamedTuple, TextIO

from torch import Tensor

from roadtorch.errors import ConfigError, InputError
from roadtorch.io.addresses import STREAMS, files_at, is_url, scheme_of, without_password
from roadtorch.io.image import read_image
from roadtorch.sources.archives import archive_source, is_archive
from roadtorch.sources.bags import bag_source, is_bag
from roadtorch.sources.frame import Selection, Source
from roadtorch.sources.live import Patience, camera_source, stream_source
from roadtorch.sources.pictures import find_images, has_pictures, picture_source
from roadtorch.sources.video import (
    VIDEO_SUFFIXES,
    count_frames,
    names_video,
    video_frames,
    video_source,
)

CAMERA = re.compile(r"(?:camera:)?(\d+)")
"""A camera's number; a file of that name goes before ``0``, never before ``camera:0``."""

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
        is_stream = camera_number(given) is not None or scheme_of(given) in STREAMS
        if is_stream or is_bag(given) or (is_archive(given) and not is_url(given)):
            sources.append(given)  # by itself, whatever it holds
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
        lines: Iterable[str] = names
        if given.startswith("@"):
            try:
                text = Path(given[1:]).read_text(encoding="utf-8", errors="surrogateescape")
            except OSError as problem:
                what = f"cannot be read: {problem.strerror}"
                raise InputError(given[1:], what, "give @ and a text file, a name a line") from None
            lines = text.split("\n")
        elif given != "-":
            yield given
            continue
        for line in lines:
            if any(letter < " " for letter in line.strip("\t\r\n")):
                remedy = "give the file itself, or names, one a line"
                raise InputError(given, "takes names of files, not their bytes", remedy)
            if line.strip():
                yield line.rstrip("\r\n")


def camera_number(given: str) -> int | None:
    """The number of the camera that an input names; None where it names none."""
    found = CAMERA.fullmatch(given)
    if found is None or (given.isdigit() and Path(given).exists()):
        return None
    return int(found[1])


@dataclass(frozen=True)
class SourceOptions:
    """What else sources are told, each kind something of its own.

    apart: a folder that is left out where folders are searched, that of the results. patience:
    with live sources. topic: of the images in bags; None where they have one.
    """

    apart: Path | None = None
    patience: Patience = field(default_factory=Patience)
    topic: str | None = None


def open_source(given: str, selection: Selection) -> Source:
    """The one source that an input stands for; pictures are one that does not move.

    Raises InputError for what is not there, ConfigError for an input of several sources.
    """
    if is_archive(given):
        return archive_source(given, selection)
    sorted_inputs = sort_inputs([given])
    if not sorted_inputs.sources:
        return picture_source(given, selection)
    sources = open_sources(sorted_inputs.sources, selection)
    if len(sources) != 1 or sorted_inputs.pictures:
        what = f"holds {len(sources)} videos" + (" and pictures" * bool(sorted_inputs.pictures))
        raise ConfigError(given, what, "give one of them")
    return sources[0]


def open_sources(
    inputs: Sequence[str],
    selection: Selection,
    options: SourceOptions = SourceOptions(),
) -> list[Source]:
    """The sources that inputs of ``sort_inputs(…).sources`` stand for, in their order.

    Raises InputError for what cannot be opened, ConfigError when two would share their results.
    """
    sources = [source for given in inputs for source in _opened(given, selection, options)]
    owners: dict[str, Source] = {}
    for source in sources:
        other = owners.setdefault(source.name, source)
        if other is not source:
            what = f"both would write {source.name}"
            where = f"{other.origin} and {source.origin}"
            raise ConfigError(where, what, "rename one, or use two --out folders")
    return sources


def _opened(given: str, selection: Selection, options: SourceOptions) -> Iterator[Source]:
    number = camera_number(given)
    if number is not None:
        yield camera_source(number, selection, options.patience)
    elif WHOLE.match(given):
        yield video_source(given, slug(given), selection)
    elif scheme_of(given) in STREAMS:
        yield stream_source(given, slug(given), selection, options.patience)
    elif is_bag(given):
        yield bag_source(given, options.topic, selection)
    elif is_archive(given):
        yield archive_source(given, selection)
    else:
        for path, name in video_files(given, options.apart):
            yield video_source(path, name, selection)


def slug(url: str) -> str:
    """A name for the results of an address: what stands between its signs, without a password."""
    address = re.sub(r"^\w+://|[?#].*", "", without_password(url))
    return re.sub(r"[^\w.]+", "-", address).strip("-.") or "stream"


def video_files(given: str, apart: Path | None = None) -> list[tuple[Path, str]]:
    """The video files of a name, folder or glob, with the names of their results."""
    files = [] if is_url(given) else files_at(given, names_video, apart)
    if files is None:
        path = Path(given)
        return [(path, path.stem)] if path.name.lower().endswith(VIDEO_SUFFIXES) else []
    return [(Path(one.origin), Path(one.name).with_suffix("").as_posix()) for one in files]


# --- single frames ----------------------------------------------------------------------


class FramePlace(NamedTuple):
    """Where a frame is: a picture file, or the number of a frame in a video file."""

    path: Path
    number: int | None


def frame_places(inputs: Sequence[str], most: int) -> list[FramePlace]:
    """At most ``most`` frames of pictures and video files, evenly over all of them, in their order.

    Raises InputError for what does not exist, holds no pictures, or is no video, ConfigError
    where there are videos and PyAV is missing.
    """
    every: list[FramePlace] = []
    for given in inputs:
        chosen = sort_inputs([given])
        every += [FramePlace(one.path, None) for one in find_images(chosen.pictures)]
        for source in chosen.sources:
            videos = video_files(source)
            if not videos:
                raise InputError(source, "is no footage on disk", "give pictures or video files")
            for path, _ in videos:
                every += [FramePlace(path, number) for number in range(count_frames(path))]
    if len(every) <= most:
        return every
    return [every[(2 * at + 1) * len(every) // (2 * most)] for at in range(most)]


def read_frames(places: Sequence[FramePlace]) -> Iterator[Tensor]:
    """The frames as images (3,H,W) in [0,1], one after the other; InputError naming a bad file.

    A video that ends early gives what it has.
    """
    for path, group in groupby(places, key=lambda place: place.path):
        numbers = [place.number for place in group]
        if numbers[0] is None:
            yield from (read_image(path) for _ in numbers)
            continue
        last = max(number for number in numbers if number is not None)
        with closing(video_frames(path, path.stem)) as frames:
            yield from (
                frame.read() for frame in islice(frames, last + 1) if frame.number in numbers
            )
