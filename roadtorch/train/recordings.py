"""Recordings among the images of a run, and the ego car that each of them shows. Ours."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.base.image import read_image
from roadtorch.base.progress import Progress
from roadtorch.base.signals import StopRequest, until_stopped
from roadtorch.camera.footage import detect_ego_car
from roadtorch.imaging.resize import WorkingSize, resize_to_image, resize_to_work, spatial_size
from roadtorch.inputs.item import Item, evenly_spaced
from roadtorch.run.memo import Arrays, cache_key, read_cached, write_cached
from roadtorch.train.config import Recordings

MAX_FRAMES = 120
"""Largest number of frames of a recording that are examined, evenly spaced."""

FRAME_SIZE = WorkingSize(pixels=640 * 480)
"""Size to which frames are reduced, as all frames of a recording are in memory at once."""

EDGE_COLUMNS, EDGE_JUMP, MAX_EDGE_JUMPS = 160, 0.012, 0.1
"""Columns at which an ego car's upper edge is sampled, the difference of neighbours that is a jump
(fraction of the height), and the largest fraction of jumps in a smooth edge."""

ASPECT_BINS = 10
"""Bins per unit of width / height, by which frames are grouped."""


def recording_name(name: str, separator: str) -> str:
    """Return a name up to its last separator, or all of it if it has none."""
    return name.rpartition(separator)[0] if separator and separator in name else name


def select_held_out(names: Sequence[str], fraction: float, separator: str) -> list[str]:
    """Select a fraction of names, at least one: whole recordings, the smallest first. Ours.

    The last names where recordings are unknown or too large, as neighbouring frames are alike.
    Empty for a single name, or a fraction of 0.
    """
    limit = math.ceil(fraction * len(names)) if len(names) > 1 else 0
    recordings: dict[str, list[str]] = {}
    for name in sorted(names):
        recordings.setdefault(recording_name(name, separator), []).append(name)
    chosen: list[str] = []
    for recording in sorted(recordings.values(), key=len):
        if len(recordings) < len(names) and len(chosen) + len(recording) <= limit:
            chosen += recording
    return chosen if 2 * len(chosen) > limit else sorted(names)[len(names) - limit :]


def find_ego_cars(
    images: Sequence[Item], folder: Path, settings: Recordings, stop: StopRequest, quiet: bool
) -> Mapping[str, Path]:
    """Find the ego car of each recording; return the file of the result by image name.

    Recordings with too few frames are left out. Files of the same images are reused.
    """
    if not settings.separator:
        return {}
    recordings: dict[str, list[Item]] = {}
    for image in images:
        recordings.setdefault(recording_name(image.name, settings.separator), []).append(image)
    long = {name: group for name, group in recordings.items() if len(group) >= settings.min_frames}
    files = {name: folder / f"{name}.npz" for name in long}
    bar = Progress(files.items(), desc="ego cars", unit="image", quiet=quiet)
    for name, file in until_stopped(bar, stop):
        frames = evenly_spaced(long[name], MAX_FRAMES)
        key = cache_key(settings.min_frames, *(image.path for image in frames))
        if read_cached(file, key) is None:
            write_cached(file, key, detect_ego_cars(frames, settings.min_frames))
    return {image.name: files[name] for name, group in long.items() for image in group}


def detect_ego_cars(images: Sequence[Item], min_frames: int) -> Arrays:
    """Detect the ego car, bool (H, W), of one camera's images; return it by ``aspect_bin``."""
    shapes: dict[int, list[Tensor]] = {}
    for image in images:
        with suppress(InputError):  # reported when it is prepared
            frame = resize_to_work(read_image(image.path), FRAME_SIZE)
            shapes.setdefault(aspect_bin(frame), []).append(frame)
    enough = {shape: frames for shape, frames in shapes.items() if len(frames) >= min_frames}
    cars = {str(shape): detect_ego_car(frames) for shape, frames in enough.items()}
    return {shape: ego for shape, ego in cars.items() if ego is not None and has_smooth_edge(ego)}


def has_smooth_edge(ego: Tensor) -> bool:
    """Return whether the upper edge of an ego car bool (H, W) is smooth, as a bonnet's is.

    In few frames of a slow drive kerbs and lane marks look static too, but with a rough edge.
    """
    height, width = ego.shape
    first = torch.where(ego.any(0), ego.to(torch.uint8).argmax(0), height) / height
    edge = first[torch.arange(EDGE_COLUMNS) * width // EDGE_COLUMNS]
    return float((edge.diff().abs() > EDGE_JUMP).double().mean()) <= MAX_EDGE_JUMPS


def aspect_bin(image: Tensor) -> int:
    """Return the bin of an image's aspect ratio, the same for all frames of a camera."""
    return round(ASPECT_BINS * image.shape[-1] / image.shape[-2])


def read_ego(file: Path | None, image: Tensor) -> Tensor | None:
    """Read the ego car of an image's recording, bool (H, W) of the image; None if there is none."""
    shape = str(aspect_bin(image))
    cars = read_cached(file, None, shape) if file else None
    return resize_to_image(cars[shape], spatial_size(image)) if cars else None
