"""Resolution of a command's inputs to images and sources of frames."""

import codecs
import os
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import groupby, islice
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from roadtorch.base.bounded import strip_password
from roadtorch.base.errors import ConfigError, InputError, RoadtorchError
from roadtorch.base.image import IMAGE_SUFFIXES, read_image
from roadtorch.base.urls import WEB_SCHEMES, slug, url_scheme
from roadtorch.inputs.bags import BAG_SUFFIXES, bag_source, is_bag
from roadtorch.inputs.images import (
    ListedFile,
    drop_duplicates,
    is_result_name,
    list_files,
    make_image_item,
    open_web_image,
)
from roadtorch.inputs.item import Item, Selection, Source, raise_error
from roadtorch.inputs.live import STREAMS, camera_source, stream_source
from roadtorch.inputs.video import VIDEO_SUFFIXES, count_frames, video_frames, video_source

CAMERA_PATTERN = re.compile(r"(?:camera:)?(\d+)")
"""Number of a camera. An existing file ``0`` takes precedence over ``0``, not over ``camera:0``."""

VIDEO_URL = re.compile(
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
    exclude: Path | None = None,
) -> Inputs:
    """Resolve inputs to images and sources, in order; a folder may contain both.

    inputs: files, folders, globs, bags, camera numbers, URLs, ``-``, ``@list.txt``. exclude: folder
    of results, which is not searched.

    Raises:
        InputError: if an input does not exist, cannot be opened or contains no images.
    """
    inputs = list(inputs)
    images: list[Item] = []
    sources: list[Source] = []
    for argument in expand_lists(inputs):
        number, scheme, name = parse_camera(argument), url_scheme(argument), slug(argument)
        if number is not None:
            sources.append(camera_source(number, selection))
        elif VIDEO_URL.match(argument):
            sources.append(video_source(argument, name, selection))
        elif scheme in WEB_SCHEMES and (image := open_web_image(argument)) is not None:
            images.append(image)
        elif scheme in STREAMS:
            sources.append(stream_source(argument, name, selection))
        else:
            files = list_files(argument, _is_footage, exclude)
            for file in files:
                if file.path.is_dir() or file.name.lower().endswith(BAG_SUFFIXES):
                    sources.append(_open_bag_in_folder(file, selection, alone=len(files) == 1))
                elif file.name.lower().endswith(VIDEO_SUFFIXES):
                    sources.append(video_source(file.path, file.stem, selection))
                else:
                    images.append(make_image_item(file))
    if inputs and not images and not sources:
        raise InputError(inputs[0], "contains no names", "give one a line")
    return Inputs(drop_duplicates(images), sources)


def _is_footage(path: str) -> bool:
    """Return whether a path is an image, a video or a bag by its name."""
    name = os.path.basename(path).lower()
    if not name or (name[0] == "." and name.strip(".")) or is_result_name(name):
        return False
    return name.endswith((*IMAGE_SUFFIXES, *VIDEO_SUFFIXES)) or is_bag(path)


def _open_bag_in_folder(file: ListedFile, selection: Selection, alone: bool) -> Source:
    """Open a bag; unless it is alone, one that cannot be opened raises when it is read."""
    name = (file.name if file.path.is_dir() else file.stem).strip(".") or file.path.resolve().name
    try:
        return bag_source(str(file.path), selection, name)
    except RoadtorchError as error:
        if alone:
            raise
        return Source(name, str(file.path), partial(raise_error, error), path=file.path)


def expand_lists(inputs: Iterable[str]) -> Iterator[str]:
    """Yield the inputs, ``-`` (not ``./-``) and ``@list.txt`` replaced by their non-empty lines."""
    for argument in inputs:
        lines: Iterable[str] = sys.stdin
        if argument.startswith("@"):
            try:
                data = Path(argument[1:]).read_bytes()
            except OSError as error:
                problem = f"cannot be read: {error.strerror}"
                raise InputError(argument[1:], problem, "give @ and a text file") from None
            is_utf_16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))  # PowerShell's
            encoding = "utf-16" if is_utf_16 else "utf-8-sig"
            lines = data.decode(encoding, "replace" if is_utf_16 else "surrogateescape").split("\n")
        elif argument != "-":
            yield argument
            continue
        for line in lines:
            line = line.removeprefix("\ufeff")  # on standard input
            if any(letter < " " for letter in line.strip("\t\r\n")):
                hint = "pass the file itself, or names, one a line"
                raise InputError(argument, "expects file names, not the contents of a file", hint)
            if line.strip():
                yield line.rstrip("\r\n")


def parse_camera(argument: str) -> int | None:
    """Return the number of the camera that an input names; None if it names none."""
    camera = CAMERA_PATTERN.fullmatch(argument)
    if camera is None or (argument.isdigit() and Path(argument).exists()):
        return None
    return int(camera[1])


def open_source(argument: str, selection: Selection) -> Source:
    """Open an input as one source; images become its frames, without a clock.

    Raises:
        InputError: if nothing is found.
        ConfigError: if there is more than one source.
    """
    images, sources = find_inputs([argument], selection)
    if not sources:
        numbered = [replace(image, number=number) for number, image in enumerate(images)]
        chosen = list(selection.select(numbered))
        name = slug(argument) if url_scheme(argument) else Path(argument).stem or "images"
        return Source(
            name, strip_password(argument), lambda: iter(chosen), count=len(chosen), footage=False
        )
    if len(sources) != 1 or images:
        problem = f"holds {len(sources)} videos" + " and images" * bool(images)
        raise ConfigError(argument, problem, "give one of them")
    return sources[0]


# --- frames by position -----------------------------------------------------------------


class FramePosition(NamedTuple):
    """Position of a frame: an image file, or a frame number in a video file."""

    path: Path
    number: int | None


def locate_frames(inputs: Sequence[str], limit: int) -> list[FramePosition]:
    """Return the positions of at most ``limit`` frames, evenly spaced over images and videos.

    Raises:
        InputError: if an input does not exist or is no footage on disk.
    """
    positions: list[FramePosition] = []
    for argument in inputs:
        images, sources = find_inputs([argument])
        positions += [FramePosition(image.path, None) for image in images]
        for source in sources:
            if (path := source.path) is None or is_bag(source.origin):
                hint = "give images or video files"
                raise InputError(source.origin, "is no footage on disk", hint)
            positions += [FramePosition(path, number) for number in range(count_frames(path))]
    if len(positions) <= limit:
        return positions
    return [positions[(2 * index + 1) * len(positions) // (2 * limit)] for index in range(limit)]


def read_frames(positions: Sequence[FramePosition]) -> Iterator[Tensor]:
    """Yield frames as images in [0, 1], shape (3, H, W); InputError names an unreadable file.

    A truncated video yields the frames that it has.
    """
    for path, group in groupby(positions, key=lambda position: position.path):
        numbers = [position.number for position in group]
        if numbers[0] is None:
            yield from (read_image(path) for _ in numbers)
            continue
        last = max(number for number in numbers if number is not None)
        with closing(video_frames(path, path.stem)) as frames:
            candidates = islice(frames, last + 1)
            yield from (frame.read() for frame in candidates if frame.number in numbers)
