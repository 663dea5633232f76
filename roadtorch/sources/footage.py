"""Frames of footage, evenly chosen: picture files, folders, globs and video files."""

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.errors import InputError
from roadtorch.image import read_image
from roadtorch.sources.pictures import find_images

VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts")


class FramePlace(NamedTuple):
    """Where a frame is: a picture file, or the number of a frame in a video file."""

    path: Path
    number: int | None


def frame_places(inputs: Sequence[str], most: int) -> list[FramePlace]:
    """At most ``most`` frames of the inputs, evenly over all of them, in their order.

    Raises InputError for what does not exist, holds no pictures, or is no video.
    """
    every = [place for given in inputs for place in _places(given)]
    if len(every) <= most:
        return every
    return [every[(2 * at + 1) * len(every) // (2 * most)] for at in range(most)]


def _places(given: str) -> Iterator[FramePlace]:
    path = Path(given)
    if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file():
        video = _opened(path)
        count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        video.release()
        yield from (FramePlace(path, number) for number in range(count))
        return
    yield from (FramePlace(picture.path, None) for picture in find_images([given]))


def read_frames(places: Sequence[FramePlace]) -> Iterator[Tensor]:
    """The frames as images (3,H,W) in [0,1], one after the other; InputError naming a bad file."""
    for path, group in itertools.groupby(places, key=lambda place: place.path):
        numbers = [place.number for place in group]
        if numbers[0] is None:
            yield from (read_image(path) for _ in numbers)
        else:
            yield from _video_frames(path, {number for number in numbers if number is not None})


def _video_frames(path: Path, numbers: set[int]) -> Iterator[Tensor]:
    """The frames of those numbers; a video that ends early gives what it has."""
    video = _opened(path)
    for number in range(max(numbers) + 1):
        if not video.grab():
            break
        if number in numbers:
            pixels = np.ascontiguousarray(video.retrieve()[1][..., ::-1].transpose(2, 0, 1))
            yield torch.from_numpy(pixels).to(torch.float32) / 255
    video.release()


def _opened(path: Path) -> cv2.VideoCapture:
    try:
        video = cv2.VideoCapture(str(path))
    except UnicodeEncodeError:  # OpenCV takes no other names
        raise InputError(path, "has a name that is not UTF-8", "rename it") from None
    if not video.isOpened():
        raise InputError(path, "cannot be decoded as video", "give MP4, AVI, MKV, MOV or WebM")
    return video
