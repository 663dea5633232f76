"""Resolution of a command's inputs to images and sources of frames."""

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import groupby, islice
from pathlib import Path, PurePosixPath
from typing import NamedTuple, TextIO

from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import READABLE, read_image
from roadtorch.base.urls import WEB, scheme_of, slug
from roadtorch.inputs.bags import bag_source, is_bag
from roadtorch.inputs.images import (
    File,
    each_once,
    files_at,
    image_item,
    names_image,
    web_image,
)
from roadtorch.inputs.item import Item, Selection, Source
from roadtorch.inputs.live import STREAMS, camera_source, stream_source
from roadtorch.inputs.video import (
    VIDEO_SUFFIXES,
    count_frames,
    names_video,
    video_frames,
    video_source,
)

CAMERA = re.compile(r"(?:camera:)?(\d+)")
"""Number of a camera. An existing file ``0`` takes precedence over ``0``, not over ``camera:0``."""

WHOLE = re.compile(
    r"https?://[^?#]*\.(mp4|m4v|mov|avi|mkv|webm|mpe?g|wmv|flv)([?#].*)?$", re.IGNORECASE
)
"""URL of a video file, every frame of which is read, unlike those of a stream."""


class Inputs(NamedTuple):
    """Images, and sources of frames."""

    images: Sequence[Item]
    sources: Sequence[Source]


def find_inputs(
    inputs: Iterable[str],
    selection: Selection = Selection(),  # noqa: B008 - it is frozen
    apart: Path | None = None,
    names: TextIO | None = None,
) -> Inputs:
    """Resolve inputs to images and sources, in order; a folder may contain both.

    Args:
        inputs: files, folders, globs, bags, camera numbers, URLs, ``-``, ``@list.txt``.
        selection: selection of the items of each source.
        apart: folder of results, which is not searched.
        names: text that ``-`` reads; standard input if None.

    Returns:
        The images and sources.

    Raises:
        InputError: if an input does not exist, cannot be opened or contains no images.
    """
    inputs = list(inputs)
    images: list[Item] = []
    sources: list[Source] = []
    for given in named(inputs, sys.stdin if names is None else names):
        number, scheme, name = camera_number(given), scheme_of(given), slug(given)
        if number is not None:
            sources.append(camera_source(number, selection))
        elif WHOLE.match(given):
            sources.append(video_source(given, name, selection))
        elif scheme in WEB and (image := web_image(given)) is not None:
            images.append(image)
        elif scheme in STREAMS:
            sources.append(stream_source(given, name, selection))
        elif is_bag(given):
            sources.append(bag_source(given, selection.topic, selection))
        else:
            files = files_at(given, names_footage, apart)
            for file in [files] if isinstance(files, File) else files:
                name = PurePosixPath(file.name).with_suffix("").as_posix()
                if not file.name.lower().endswith(VIDEO_SUFFIXES):
                    images.append(image_item(file.path, name))
                else:
                    sources.append(video_source(file.path, name, selection))
            if not files:
                raise InputError(given, "holds no images", f"give {READABLE} files")
    if inputs and not images and not sources:
        raise InputError(inputs[0], "names nothing", "give names, one a line")
    return Inputs(each_once(images), sources)


def select_inputs(inputs: Iterable[str], selection: Selection, out: Path) -> Inputs:
    """Resolve inputs outside ``out`` and apply a selection; raises as its two steps do."""
    images, sources = find_inputs(inputs, selection, out)
    return Inputs(selection.of_images(images), sources)


def names_footage(name: str) -> bool:
    """Return whether a file name is that of an image or video, and of no result."""
    return names_image(name) or names_video(name)


def named(inputs: Iterable[str], names: TextIO) -> Iterator[str]:
    """Yield the inputs with ``-`` and ``@list.txt`` replaced by their non-empty lines.

    Write ``./-`` for a file called ``-``.
    """
    for given in inputs:
        lines: Iterable[str] = names
        if given.startswith("@"):
            try:
                text = Path(given[1:]).read_text(encoding="utf-8", errors="surrogateescape")
            except OSError as error:
                problem = f"cannot be read: {error.strerror}"
                raise InputError(
                    given[1:], problem, "give @ and a text file, a name a line"
                ) from None
            lines = text.split("\n")
        elif given != "-":
            yield given
            continue
        for line in lines:
            if any(letter < " " for letter in line.strip("\t\r\n")):
                hint = "give the file itself, or names, one a line"
                raise InputError(given, "takes names of files, not their bytes", hint)
            if line.strip():
                yield line.rstrip("\r\n")


def camera_number(given: str) -> int | None:
    """Return the number of the camera that an input names; None if it names none."""
    camera = CAMERA.fullmatch(given)
    if camera is None or (given.isdigit() and Path(given).exists()):
        return None
    return int(camera[1])


def open_source(given: str, selection: Selection) -> Source:
    """Open an input as one source; images become its frames, without a clock.

    Raises:
        InputError: if nothing is found.
        ConfigError: if there is more than one source.
    """
    images, sources = find_inputs([given], selection)
    if not sources:
        numbered = [replace(image, number=number) for number, image in enumerate(images)]
        chosen = list(selection.of(numbered))
        name = Path(given).stem or "images"
        return Source(name, given, lambda: iter(chosen), count=len(chosen))
    if len(sources) != 1 or images:
        problem = f"holds {len(sources)} videos" + " and images" * bool(images)
        raise ConfigError(given, problem, "give one of them")
    return sources[0]


# --- single frames ----------------------------------------------------------------------


class FramePlace(NamedTuple):
    """Position of a frame: an image file, or a frame number in a video file."""

    path: Path
    number: int | None


def frame_places(inputs: Sequence[str], most: int) -> list[FramePlace]:
    """Return the positions of at most ``most`` frames, evenly spaced over images and videos.

    Raises:
        InputError: if an input does not exist or is no footage on disk.
    """
    every: list[FramePlace] = []
    for given in inputs:
        images, sources = find_inputs([given])
        every += [FramePlace(image.path, None) for image in images]
        for source in sources:
            if (path := source.path) is None:
                raise InputError(given, "is no footage on disk", "give images or video files")
            every += [FramePlace(path, number) for number in range(count_frames(path))]
    if len(every) <= most:
        return every
    return [every[(2 * place + 1) * len(every) // (2 * most)] for place in range(most)]


def read_frames(places: Sequence[FramePlace]) -> Iterator[Tensor]:
    """Yield frames as images in [0, 1], shape (3, H, W); InputError names an unreadable file.

    A truncated video yields the frames that it has.
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
