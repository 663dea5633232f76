"""Recordings among the pictures of a run, and the ego car that each of them shows. Ours."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.camera.footage import still_ego
from roadtorch.errors import InputError
from roadtorch.imaging.resize import WorkingSize, at_picture_size, at_work, size_of
from roadtorch.io.atomic import make_folder, write_text
from roadtorch.io.image import read_image
from roadtorch.sources.frame import spread
from roadtorch.sources.pictures import Picture
from roadtorch.train.config import Recordings
from roadtorch.train.prepared import read_arrays, write_arrays
from roadtorch.train.processes import Processes

DONE = "done"
"""The file that says that a recording has been looked at."""

MAX_FRAMES = 120
"""Frames of one recording that are looked at, evenly spread: more show nothing new."""

SEEN = WorkingSize(pixels=640 * 480)
"""How large frames are kept: all of one recording are in memory at once."""

COLUMNS, JUMP, MAX_JUMPS = 160, 0.012, 0.1
"""Columns in which the edge of an ego car is looked at, the share of the height that is a jump
from one to the next, and the share of jumps above which it is no line."""

SHAPES = 10
"""Steps of width / height per unit: frames of one camera are of one shape."""


def recording_of(name: str, separator: str) -> str:
    """A name up to the last separator; all of it where there is none, or no separator is set."""
    return name.rpartition(separator)[0] if separator and separator in name else name


def find_ego_cars(
    pictures: Sequence[Picture], folder: Path, settings: Recordings, processes: Processes
) -> Mapping[str, Path]:
    """Look in each recording for the ego car; the folder of what was found, by picture name.

    Pictures of small recordings are left out. What was found before is not looked for again.
    """
    if not settings.separator:
        return {}
    recordings: dict[str, list[Picture]] = {}
    for picture in pictures:
        recordings.setdefault(recording_of(picture.name, settings.separator), []).append(picture)
    long = {name: each for name, each in recordings.items() if len(each) >= settings.least}
    for name in processes.each(list(long), "ego cars"):
        if not (folder / name / DONE).exists():
            _write_ego_car(long[name], folder / name, settings.least)
    processes.gather(None)  # nobody reads before all have written
    return {picture.name: folder / name for name, each in long.items() for picture in each}


def _write_ego_car(recording: Sequence[Picture], folder: Path, least: int) -> None:
    """Write the ego car of each shape of a recording."""
    shapes: dict[int, list[Tensor]] = {}
    for picture in spread(recording, MAX_FRAMES):
        try:
            image = at_work(read_image(picture.path), SEEN)
        except InputError:
            continue  # told when it is made ready
        shapes.setdefault(shape_of(image), []).append(image)
    make_folder(folder)
    for shape, frames in shapes.items():
        ego = still_ego(frames) if len(frames) >= least else None
        if ego is not None and is_line(ego):
            write_arrays(folder / f"{shape}.npz", {"ego": ego})
    write_text(folder / DONE, "")


def is_line(ego: Tensor) -> bool:
    """Whether the upper edge of an ego car bool (H,W) is a line, as a bonnet's is.

    Where few frames of a slow drive are alike, kerbs and lane marks look still as well; a path
    through them jumps.
    """
    height, width = ego.shape
    first = torch.where(ego.any(0), ego.to(torch.uint8).argmax(0), height) / height
    edge = first[torch.arange(COLUMNS) * width // COLUMNS]
    return float((edge.diff().abs() > JUMP).double().mean()) <= MAX_JUMPS


def shape_of(image: Tensor) -> int:
    """A number that frames of one camera share: ten times width over height, rounded."""
    return round(SHAPES * image.shape[-1] / image.shape[-2])


def ego_of(folder: Path | None, image: Tensor) -> Tensor | None:
    """The ego car of an image's recording, bool (H,W) of its size; None where none is known."""
    path = folder / f"{shape_of(image)}.npz" if folder else None
    if path is None or not path.exists():
        return None
    return at_picture_size(read_arrays(path, "ego")["ego"], size_of(image))
