"""The frames of footage that an adaptation learns from: a limited number, in two halves.

Consecutive frames show the same places (``write_taught``), so longer footage is sampled in runs of
consecutive frames.
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
from roadtorch.base.image import write_jpeg
from roadtorch.base.progress import Progress
from roadtorch.imaging.resize import at_work
from roadtorch.inputs.find import Inputs, find_inputs
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.run.memo import key_of
from roadtorch.train.recordings import SEEN

HALVES = ("first", "second")
"""Halves of the footage in order, as neighbouring frames are alike and must stay in one half."""

SECONDS = 0.4
"""Interval between sampled frames, in which the ground before the car stays in view."""

STRETCH = 5
"""Consecutive frames that are kept or dropped together in longer footage."""

LIST = "frames.json"


class KeptFrames(NamedTuple):
    """The frames that were sampled from footage.

    folder: contains HALF_NUMBER.jpg. halves: number of frames of each. moving: whether the frames
    have times. skipped: inputs that could not be read, a line each.
    """

    folder: Path
    halves: tuple[int, int]
    moving: bool
    skipped: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of frames."""
        return sum(self.halves)

    def images(self, half: str = "*") -> list[Item]:
        """Return the sampled frames, or those of a half, in order."""
        return find_images([self.glob(half)])

    def glob(self, half: str = "*") -> str:
        """Return the quoted glob of a half; frames have the same names in all globs."""
        return f"{glob.escape(str(self.folder))}/{half}_*.jpg"


def keep_frames(inputs: Sequence[str], folder: Path, most: int, quiet: bool = False) -> KeptFrames:
    """Sample at most ``most`` frames of footage into a folder; a finished sample is reused.

    A frame every ``SECONDS`` of videos and bags, all images; runs of ``STRETCH`` frames of long
    footage. Memory does not grow with the footage. Raises ConfigError if the folder holds frames
    of other footage, InputError for fewer than two readable frames.
    """
    images, sources = find_inputs(inputs)
    digests = [item.digest() if item.digest else "" for item in [*images, *sources]]
    known, key = folder / LIST, key_of(digests, most)
    if not known.exists():
        if folder.exists() and any(folder.iterdir()):
            raise ConfigError(folder, "holds files that are not of a run", "give another --out")
        make_folder(folder)
        write_json(known, {"key": key, "halves": None})
    kept = _read(known, folder, key)
    if kept is None:
        for file in folder.glob("*.jpg"):  # of a run that was cut short
            file.unlink()
        kept = _keep(Inputs(images, sources), folder, most, quiet)
        if kept.count < 2:  # nothing that the next run should take as it is
            raise InputError(inputs[0], f"has {kept.count} frames", "give some minutes of a drive")
        rest = {"halves": kept.halves, "moving": kept.moving, "skipped": kept.skipped}
        write_json(known, {"key": key, **rest})
    return kept


def _read(known: Path, folder: Path, key: str) -> KeptFrames | None:
    """Read the list of frames in a folder; None if sampling was not finished."""
    try:
        values = json.loads(read_regular(known).decode())
        if values["key"] != key:
            raise ConfigError(folder, "holds frames of other footage", "give another --out")
        if values["halves"] is None:
            return None
        first, second = (int(count) for count in values["halves"])
        skipped = tuple(map(str, values["skipped"]))
        return KeptFrames(folder, (first, second), bool(values["moving"]), skipped)
    except (ValueError, KeyError, TypeError, OSError):
        raise InputError(known, "is damaged", "give another --out") from None


def _keep(inputs: Inputs, folder: Path, most: int, quiet: bool) -> KeptFrames:
    """Write frames while reading; when there are too many, drop every second run of frames."""
    numbers: list[int] = []
    skipped: list[str] = []
    step, moving = 1, False
    frames = Progress(_frames(inputs, skipped), desc="frames", unit="frame", quiet=quiet)
    for number, (seconds, image) in enumerate(frames):
        moving = moving or seconds is not None
        if number // STRETCH % step:
            continue
        write_jpeg(folder / f"{number:08d}.jpg", at_work(image, SEEN))
        numbers.append(number)
        if len(numbers) >= 2 * most:
            step *= 2
            numbers = _thinned(folder, numbers, range(0, number + 1, step))
    if len(numbers) > most:
        stretches = sorted({number // STRETCH for number in numbers})
        count = math.ceil(most / STRETCH)
        some = [stretches[place * len(stretches) // count] for place in range(count)]
        numbers = _thinned(folder, numbers, some, most)
    first = (len(numbers) + 1) // 2
    for place, number in enumerate(numbers):
        name = f"{HALVES[place >= first]}_{place:06d}.jpg"
        (folder / f"{number:08d}.jpg").rename(folder / name)
    counts = (first, len(numbers) - first)
    return KeptFrames(folder, counts, moving, tuple(skipped))


def _thinned(
    folder: Path, numbers: list[int], stretches: Sequence[int], most: int | None = None
) -> list[int]:
    """Remove the files of frames outside some runs; return the numbers of the rest, limited."""
    kept = [number for number in numbers if number // STRETCH in stretches][:most]
    for number in set(numbers).difference(kept):
        (folder / f"{number:08d}.jpg").unlink()
    return kept


def _frames(inputs: Inputs, skipped: list[str]) -> Iterator[tuple[float | None, Tensor]]:
    """Yield every image, and the frames ``SECONDS`` apart of videos and bags, with their times."""
    for image in inputs.images:
        try:
            yield None, image.read()
        except RoadtorchError as error:
            skipped.append(str(error))
    for source in inputs.sources:
        if source.live:
            raise ConfigError(source.origin, "is live, and has no end", "record some minutes of it")
        due = 0.0
        with closing(source.items()) as frames:  # type: ignore[arg-type]
            while True:
                try:
                    if (frame := next(frames, None)) is None:
                        break
                    if frame.clock > due - 1e-3:  # times are rounded
                        due = frame.clock + SECONDS
                        yield frame.seconds, frame.read()
                except RoadtorchError as error:  # behind it the frames go on, or end
                    skipped.append(str(error))
