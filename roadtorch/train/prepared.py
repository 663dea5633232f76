"""Pictures made ready for training, once, on disk: small, with their machine labels."""

import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.base.compute import single_threaded
from roadtorch.base.errors import InputError, RoadtorchError
from roadtorch.base.progress import Progress
from roadtorch.base.signals import Stop
from roadtorch.detectors.detector import checked_image
from roadtorch.inputs.item import Item
from roadtorch.run.loop import until_stopped
from roadtorch.run.memo import Arrays, keep, kept
from roadtorch.run.workers import DIED, workers_for


def to_bytes(values: Tensor) -> Tensor:
    """Values in [0,1] as bytes: round(255 x)."""
    return values.mul(255).round_().to(torch.uint8)


def from_bytes(values: Tensor) -> Tensor:
    """Bytes as float32 in [0,1]."""
    return values.to(torch.float32).div_(255)


@dataclass(frozen=True)
class PreparedPicture:
    """A picture and the file with what training needs of it; no file where it failed."""

    name: str
    file: Path | None
    problem: str = ""


@dataclass(frozen=True)
class Preparation:
    """The work on one picture.

    key: of a picture and all that decides on what is made of it. make: turns an image (3,H,W) in
    [0,1] and the picture's name into named arrays.
    """

    folder: Path
    key: Callable[[Item], str]
    make: Callable[[Tensor, str], Arrays]

    def __call__(self, picture: Item) -> PreparedPicture:
        """The picture made ready, unless it is; ConfigError where a setting is wrong."""
        name, key = name_of(picture), self.key(picture)
        file = self.folder / f"{name}.npz"
        if kept(file, key) is not None:  # all of it is read: damage would end the training later
            return PreparedPicture(name, file)
        try:
            arrays = self.make(checked_image(picture.read()), picture.name)
        except InputError as problem:
            where = picture.path if problem.where == "image" else problem.where
            return PreparedPicture(name, None, str(InputError(where, problem.what, problem.remedy)))
        except RoadtorchError:
            raise  # a setting is wrong, not this picture
        except Exception as problem:
            # One picture that trips a detector must not cost the night's run.
            text = f"{picture.path}: {type(problem).__name__}: {problem} (report it)"
            return PreparedPicture(name, None, " ".join(text.split()))
        keep(file, key, arrays)
        return PreparedPicture(name, file)


def prepare(
    pictures: Sequence[Item], preparation: Preparation, stop: Stop, quiet: bool = False
) -> list[PreparedPicture]:
    """Make every picture ready that is not yet; what fails is told and skipped.

    Returns one item a picture, in their order. Stops early when asked to: then only what is ready
    comes back.
    """
    made, count = list[PreparedPicture](), len(pictures)
    with single_threaded():
        workers = workers_for(None, count)
        results = workers.map(preparation, until_stopped(pictures, stop), _died)
        bar = Progress(results, total=count, desc="labels", unit="image", quiet=quiet)
        with closing(results):
            for result in bar:
                made.append(result)
                if result.problem:
                    Progress.write(f"roadtorch: skipped: {result.problem}", file=sys.stderr)
    return made


def _died(picture: Item) -> PreparedPicture:
    return PreparedPicture(name_of(picture), None, str(InputError(picture.origin, *DIED)))


def name_of(picture: Item) -> str:
    """The picture's relative name with its suffix: two of one stem stay two."""
    return picture.name + picture.suffix
