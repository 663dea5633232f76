"""Frames of footage that an adaptation learns from: a limited number, in two halves.

Labels are smoothed over consecutive frames, so longer footage is sampled in runs of them.
"""

import glob
import json
import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from roadtorch.base.atomic import make_folder, write_json
from roadtorch.base.bounded import read_regular
from roadtorch.base.errors import ConfigError, InputError, RoadtorchError
from roadtorch.base.image import write_rgb
from roadtorch.base.progress import Progress
from roadtorch.imaging.resize import WorkingSize, resize_to_work
from roadtorch.inputs.find import Inputs, find_inputs
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.run.memo import cache_key

HALVES = ("first", "second")
"""Halves of the footage by time, so that neighbouring frames, which are alike, stay together."""

FRAME_INTERVAL = 0.4
"""Seconds between sampled frames, few enough for the ground ahead to stay in view."""

FRAME_SIZE = WorkingSize(pixels=640 * 480)
"""Size to which frames are reduced, as all of them are in memory at once."""

RUN_LENGTH = 5
"""Number of consecutive frames that are kept or dropped together in longer footage."""

FRAME_LIST = "frames.json"


class SampledFrames(NamedTuple):
    """The frames that were sampled from footage.

    folder: contains HALF_NUMBER.jpg. halves: number of frames in each. has_times: whether any
    frame has a time stamp. skipped: an error message for each unreadable input.
    """

    folder: Path
    halves: tuple[int, int]
    has_times: bool
    skipped: tuple[str, ...]

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return sum(self.halves)

    def images(self, half: str = "*") -> list[Item]:
        """Return the sampled frames, or those of a half, in order."""
        return find_images([self.glob(half)])

    def glob(self, half: str = "*") -> str:
        """Return the glob of a half; a frame's name does not depend on the glob that finds it."""
        return f"{glob.escape(str(self.folder))}/{half}_*.jpg"


def sample_frames(
    inputs: Sequence[str], folder: Path, limit: int, quiet: bool = False
) -> SampledFrames:
    """Sample at most ``limit`` frames of footage into a folder; a finished sample is reused.

    Takes all images, and a frame every ``FRAME_INTERVAL`` of videos and bags; if they are too
    many, evenly spaced runs of ``RUN_LENGTH``. Frames of an unfinished sample are removed: the
    folder has to be roadtorch's (``RunFolder.lock``). Raises ConfigError if it holds frames of
    other footage, InputError for fewer than two readable frames.
    """
    images, sources = find_inputs(inputs)
    digests = [(item.digest and item.digest()) or item.origin for item in [*images, *sources]]
    list_file, key = folder / FRAME_LIST, cache_key(digests, limit)
    sample = _read(list_file, folder, key)
    if sample is None:
        make_folder(folder)
        for file in folder.glob("*.jpg"):  # of an interrupted run
            file.unlink()
        sample = _write_frames(Inputs(images, sources), folder, limit, quiet)
        if sample.frame_count < 2:  # not recorded, so that the next run samples again
            problem = f"has {sample.frame_count} frames"
            raise InputError(inputs[0], problem, "give a few minutes of a drive")
        values = {"halves": sample.halves, "moving": sample.has_times, "skipped": sample.skipped}
        write_json(list_file, {"key": key, **values})
    return sample


def _read(list_file: Path, folder: Path, key: str) -> SampledFrames | None:
    """Read the list of frames in a folder; None if sampling was not finished."""
    if not list_file.exists():
        return None
    try:
        values = json.loads(read_regular(list_file).decode())
        if values["key"] != key:
            raise ConfigError(folder, "holds frames of other footage", "give another --out")
        first, second = (int(count) for count in values["halves"])
        skipped = tuple(map(str, values["skipped"]))
        return SampledFrames(folder, (first, second), bool(values["moving"]), skipped)
    except (ValueError, KeyError, TypeError, OSError):
        raise InputError(list_file, "is damaged", "give another --out") from None


def _write_frames(inputs: Inputs, folder: Path, limit: int, quiet: bool) -> SampledFrames:
    """Write frames while reading; at twice ``limit``, drop every second run of frames."""
    numbers: list[int] = []
    skipped: list[str] = []
    step, has_times = 1, False
    frames = Progress(_frames(inputs, skipped), desc="frames", unit="frame", quiet=quiet)
    for number, (seconds, image) in enumerate(frames):
        has_times = has_times or seconds is not None
        if number // RUN_LENGTH % step:
            continue
        write_rgb(folder / f"{number:08d}.jpg", resize_to_work(image, FRAME_SIZE))
        numbers.append(number)
        if len(numbers) >= 2 * limit:
            step *= 2
            numbers = _thin(folder, numbers, range(0, number + 1, step))
    if len(numbers) > limit:
        runs = sorted({number // RUN_LENGTH for number in numbers})
        count = math.ceil(limit / RUN_LENGTH)
        chosen = [runs[index * len(runs) // count] for index in range(count)]
        numbers = _thin(folder, numbers, chosen, limit)
    first = (len(numbers) + 1) // 2
    for index, number in enumerate(numbers):
        name = f"{HALVES[index >= first]}_{index:06d}.jpg"
        (folder / f"{number:08d}.jpg").rename(folder / name)
    counts = (first, len(numbers) - first)
    return SampledFrames(folder, counts, has_times, tuple(skipped))


def _thin(
    folder: Path, numbers: list[int], runs: Sequence[int], limit: int | None = None
) -> list[int]:
    """Remove all frames but the first ``limit`` of the runs; return the remaining numbers."""
    remaining = [number for number in numbers if number // RUN_LENGTH in runs][:limit]
    for number in set(numbers).difference(remaining):
        (folder / f"{number:08d}.jpg").unlink()
    return remaining


def _frames(inputs: Inputs, skipped: list[str]) -> Iterator[tuple[float | None, Tensor]]:
    """Yield all images, and a frame every ``FRAME_INTERVAL`` of videos and bags, with its time."""
    for image in inputs.images:
        try:
            yield None, image.read()
        except RoadtorchError as error:
            skipped.append(str(error))
    for source in inputs.sources:
        if source.live:
            raise ConfigError(source.origin, "is live and has no end", "record a few minutes")
        due = 0.0
        with closing(source.items()) as frames:  # type: ignore[arg-type]
            while True:
                try:
                    if (frame := next(frames, None)) is None:
                        break
                    if frame.clock > due - 1e-3:  # times are rounded
                        due = frame.clock + FRAME_INTERVAL
                        yield frame.seconds, frame.read()
                except RoadtorchError as error:  # further frames may follow
                    skipped.append(str(error))
