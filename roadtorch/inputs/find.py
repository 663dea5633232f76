"""What the inputs of a command stand for: images, and sources that give frame after frame."""

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
"""A camera's number; a file of that name goes before ``0``, never before ``camera:0``."""

WHOLE = re.compile(
    r"https?://[^?#]*\.(mp4|m4v|mov|avi|mkv|webm|mpe?g|wmv|flv)([?#].*)?$", re.IGNORECASE
)
"""The address of a video that is read to its end, every frame, not of a stream."""


class Inputs(NamedTuple):
    """What inputs stand for: images that stand alone, and what is looked at frame by frame."""

    images: Sequence[Item]
    sources: Sequence[Source]


def find_inputs(
    inputs: Iterable[str],
    selection: Selection = Selection(),  # noqa: B008 - it is frozen
    apart: Path | None = None,
    names: TextIO | None = None,
) -> Inputs:
    """Return the images and sources that inputs stand for, in order; a folder may hold both.

    apart: a folder that is left out where folders are searched, that of the results. names: what
    ``-`` reads, standard input where it is None. Raises InputError for a list that cannot be read,
    for what holds neither, does not exist or cannot be opened.
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
    """Return the chosen images and sources of inputs but those in ``out``, where results go.

    Raises as ``find_inputs`` and ``Selection.of_images`` do.
    """
    images, sources = find_inputs(inputs, selection, out)
    return Inputs(selection.of_images(images), sources)


def names_footage(name: str) -> bool:
    """Return whether a file of that name is an image or a video to look at."""
    return names_image(name) or names_video(name)


def named(inputs: Iterable[str], names: TextIO) -> Iterator[str]:
    """The inputs, with ``-`` and ``@list.txt`` replaced by the lines that they hold.

    Empty lines are left out. A file named ``-`` or ``@…`` is given as ``./-``.
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
    """The number of the camera that an input names; None where it names none."""
    camera = CAMERA.fullmatch(given)
    if camera is None or (given.isdigit() and Path(given).exists()):
        return None
    return int(camera[1])


def open_source(given: str, selection: Selection) -> Source:
    """Return the one source that an input stands for; images are one of frames without a clock.

    Raises InputError for what is not there, ConfigError for an input of several sources.
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
    """Where a frame is: an image file, or the number of a frame in a video file."""

    path: Path
    number: int | None


def frame_places(inputs: Sequence[str], most: int) -> list[FramePlace]:
    """At most ``most`` frames of images and video files, evenly over all of them, in their order.

    Raises InputError for what does not exist, holds no images, or is no video, ConfigError
    where there are videos and PyAV is missing.
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
