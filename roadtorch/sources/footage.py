"""Frames of footage, evenly chosen: picture files, folders, globs and video files."""

import itertools
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from roadtorch.errors import InputError
from roadtorch.io.image import read_image
from roadtorch.sources.open import sort_inputs, video_files
from roadtorch.sources.pictures import find_images
from roadtorch.sources.video import count_frames, video_frames


class FramePlace(NamedTuple):
    """Where a frame is: a picture file, or the number of a frame in a video file."""

    path: Path
    number: int | None


def frame_places(inputs: Sequence[str], most: int) -> list[FramePlace]:
    """At most ``most`` frames of the inputs, evenly over all of them, in their order.

    Raises InputError for what does not exist, holds no pictures, or is no video, ConfigError
    where there are videos and PyAV is missing.
    """
    every = [place for given in inputs for place in _places(given)]
    if len(every) <= most:
        return every
    return [every[(2 * at + 1) * len(every) // (2 * most)] for at in range(most)]


def _places(given: str) -> Iterator[FramePlace]:
    chosen = sort_inputs([given])
    yield from (FramePlace(one.path, None) for one in find_images(chosen.pictures))
    for source in chosen.sources:
        videos = video_files(source)
        if not videos:
            raise InputError(source, "is no footage on disk", "give pictures or video files")
        for path, _ in videos:
            yield from (FramePlace(path, number) for number in range(count_frames(path)))


def read_frames(places: Sequence[FramePlace]) -> Iterator[Tensor]:
    """The frames as images (3,H,W) in [0,1], one after the other; InputError naming a bad file."""
    for path, group in itertools.groupby(places, key=lambda place: place.path):
        numbers = [place.number for place in group]
        if numbers[0] is None:
            yield from (read_image(path) for _ in numbers)
        else:
            yield from _frames_of(path, {number for number in numbers if number is not None})


def _frames_of(path: Path, numbers: set[int]) -> Iterator[Tensor]:
    """The frames of those numbers; a video that ends early gives what it has."""
    with closing(video_frames(path, path.stem)) as frames:
        for frame in itertools.takewhile(lambda frame: frame.number <= max(numbers), frames):
            if frame.number in numbers:
                yield frame.read()
