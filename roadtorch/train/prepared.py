"""Pictures made ready for training, once, on disk: small, with their machine labels."""

import io
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from roadtorch.detector import checked_image
from roadtorch.errors import ConfigError, InputError, RoadtorchError
from roadtorch.io.atomic import atomic, make_folder, write_text
from roadtorch.io.bounded import read_regular
from roadtorch.io.image import read_image
from roadtorch.runtime.progress import Progress
from roadtorch.sources.pictures import Picture
from roadtorch.train.processes import Processes

# --- named arrays on disk ---------------------------------------------------------------


Arrays = dict[str, Tensor]

CACHED_PICTURES = 1000
"""Pictures whose arrays are kept in memory, about 0.2 MB each: reading and unpacking one takes a
quarter of the time of varying it."""


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write named tensors as compressed NumPy archive, whole or not at all."""
    with atomic(path) as temporary, temporary.open("wb") as file:
        named = {name: value.numpy() for name, value in arrays.items()}
        np.savez_compressed(file, allow_pickle=False, **named)


def read_arrays(path: Path, *names: str) -> Arrays:
    """The named tensors of an archive, all where none is named; InputError for a damaged one."""
    try:
        with np.load(io.BytesIO(read_regular(path)), allow_pickle=False) as archive:
            return {name: torch.from_numpy(archive[name]) for name in names or archive.files}
    except Exception:  # zipfile, zlib and NumPy raise anything for foreign bytes
        raise InputError(path, "is damaged", "remove it; it will be made again") from None


def kept_arrays() -> Callable[..., Arrays]:
    """``read_arrays`` that keeps what it has read last; nobody may change what it gives."""
    return lru_cache(maxsize=CACHED_PICTURES)(read_arrays)


def to_bytes(values: Tensor) -> Tensor:
    """Values in [0,1] as bytes: round(255 x)."""
    return values.mul(255).round_().to(torch.uint8)


def from_bytes(values: Tensor) -> Tensor:
    """Bytes as float32 in [0,1]."""
    return values.to(torch.float32).div_(255)


# --- prepared pictures ------------------------------------------------------------------


SETTINGS = "settings.json"
SOURCE = "source"  # the array that holds the picture's size in bytes


@dataclass(frozen=True)
class PreparedPicture:
    """A picture and the file with what training needs of it; no file where it failed."""

    name: str
    file: Path | None
    problem: str = ""


@dataclass(frozen=True)
class PreparedFolder:
    """The folder of prepared pictures, and who fills it."""

    path: Path
    processes: Processes

    def claim(self, settings: Mapping[str, Any]) -> None:
        """Take the folder for these settings; ConfigError when it was used with others."""
        path = self.path / SETTINGS
        text = json.dumps(settings, indent=1, sort_keys=True) + "\n"
        if path.exists():
            try:
                same = read_regular(path) == text.encode()
            except OSError as problem:
                what = f"cannot be read: {problem.strerror}"
                raise ConfigError(path, what, "give another folder") from None
            if not same:
                what = "holds pictures prepared with other settings"
                raise ConfigError(self.path, what, "give another folder")
        elif self.processes.leads:
            make_folder(self.path)
            write_text(path, text)

    def prepare(
        self, pictures: Sequence[Picture], make: Callable[[Tensor, str], Arrays], title: str
    ) -> list[PreparedPicture]:
        """Make every picture ready that is not yet; what fails is told and skipped.

        ``make`` turns an image (3,H,W) in [0,1] and the picture's name into named arrays.
        Returns one item a picture, in their order, in every process. Stops early when asked
        to: then only what is ready comes back.
        """
        made = [self._one(picture, make) for picture in self.processes.each(pictures, title)]
        by_name = {item.name: item for items in self.processes.gather(made) for item in items}
        return [by_name[name] for name in map(name_of, pictures) if name in by_name]

    def _one(self, picture: Picture, make: Callable[[Tensor, str], Arrays]) -> PreparedPicture:
        name = name_of(picture)
        file = self.path / f"{name}.npz"
        try:  # all of it is read: damage found later would end the training
            if file.exists() and bool(read_arrays(file)[SOURCE] == bytes_of(picture)):
                return PreparedPicture(name, file)
        except (InputError, KeyError, RuntimeError):  # RuntimeError: more than one number
            pass
        try:
            arrays = make(checked_image(read_image(picture.path)), picture.name)
        except InputError as problem:
            where = picture.path if problem.where == "image" else problem.where
            why = str(InputError(where, problem.what, problem.remedy))
        except RoadtorchError:
            raise  # a setting is wrong, not this picture
        except Exception as problem:
            # One picture that trips a detector must not cost the night's run.
            text = f"{picture.path}: {type(problem).__name__}: {problem} (report it)"
            why = " ".join(text.split())
        else:
            make_folder(file.parent)
            write_arrays(file, arrays | {SOURCE: torch.tensor(bytes_of(picture))})
            return PreparedPicture(name, file)
        Progress.write(f"roadtorch: skipped: {why}", file=sys.stderr)
        return PreparedPicture(name, None, why)


def bytes_of(picture: Picture) -> int:
    """The size of a picture's file; -1 where it is gone."""
    return picture.path.stat().st_size if picture.path.exists() else -1


def name_of(picture: Picture) -> str:
    """The picture's relative name with its suffix: two of one stem stay two."""
    return picture.name + picture.path.suffix
