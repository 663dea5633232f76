"""Videos and bags to mutate, and their readers."""

import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np

from roadtorch.base.errors import InputError
from roadtorch.inputs.bags import bag_source
from roadtorch.inputs.item import Selection, Source
from roadtorch.inputs.video import video_source
from tests.fuzz.mutations import Draw, choose, mutate, scene, write_file
from tests.inputs.bags import FIRST, ROS1, ROS2, STEP, raw_image, write_bag
from tests.videos import write_video

CODECS = {
    **{".mp4": "libx264", ".mov": "mpeg4", ".avi": "mjpeg", ".mkv": "libx264"},
    **{".webm": "libvpx", ".m4v": "mpeg4"},
}
SCENES = 3


def is_plausible(source: Source, is_right: Callable[[np.ndarray], bool]) -> bool:
    """Return whether each frame is right or is refused by its name.

    is_right: check of the pixels (H, W, 3) of a frame, 0 to 255.
    """
    for frame in source.items():
        try:
            pixels = frame.read().mul(255).round().permute(1, 2, 0).numpy()
        except InputError as error:
            if error.where != frame.origin:
                return False
        else:
            if not is_right(pixels):
                return False
    return True


@cache
def video(suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        seconds = [number / 10 for number in range(12)]
        path = Path(folder, f"a{suffix}")
        return write_video(path, seconds, codec=CODECS[suffix], ticks=10).read_bytes()


def make_video(draw: Draw, folder: Path) -> Path:
    suffix = choose(draw, *CODECS)
    return write_file(folder / f"drive{suffix}", mutate(draw, video(suffix)))


def read_video(path: Path) -> bool:
    return is_plausible(video_source(path, "drive", Selection()), lambda pixels: pixels.ndim == 3)


@cache
def bag(form: str) -> Mapping[str, bytes]:
    """Write a bag and return its files by name."""
    with tempfile.TemporaryDirectory() as folder:
        store = ROS1 if form == "bag" else ROS2
        images = [
            raw_image(store, np.asarray(scene(number)), "rgb8", FIRST + STEP * number)
            for number in range(SCENES)
        ]
        name = "drive.bag" if form == "bag" else "drive"
        path = write_bag(Path(folder, name), {"/i": images}, form)
        files = [path] if form == "bag" else sorted(path.iterdir())
        return {file.name: file.read_bytes() for file in files}


def make_bag(draw: Draw, folder: Path) -> Path:
    """Write a bag of one file, or of a folder of files, one of them mutated."""
    form = choose(draw, "bag", "sqlite3", "mcap")
    files = bag(form)
    path = folder if form == "bag" else folder / "drive"
    path.mkdir(exist_ok=True)
    spoiled = choose(draw, *files)
    for name, data in files.items():
        write_file(path / name, mutate(draw, data) if name == spoiled else data)
    return path / "drive.bag" if form == "bag" else path


def read_bag(path: Path) -> bool:
    """Read a bag; its pixels may be changed: uncompressed bags have no checksum."""
    shape = np.asarray(scene(0)).shape
    return is_plausible(bag_source(str(path)), lambda pixels: pixels.shape == shape)


FOOTAGE = {"videos": (make_video, read_video), "bags": (make_bag, read_bag)}
"""Kinds whose file names vary: a writer and a reader each."""
