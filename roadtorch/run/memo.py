"""What commands remember beside their results: named arrays, under a key of all they depend on."""

import hashlib
import io
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from roadtorch.base.atomic import atomic, digest_of, make_folder
from roadtorch.base.bounded import read_regular
from roadtorch.base.errors import InputError
from roadtorch.base.version import __version__
from roadtorch.detectors.detector import Detector
from roadtorch.layout.weights import tensors_hash, weights_path

Arrays = dict[str, Tensor]

KEY = "key"
"""The array that holds the key."""

CACHED = 1000
"""Files whose arrays are kept in memory, about 0.2 MB each: reading and unpacking one takes a
quarter of the time of varying it."""


def key_of(*parts: object) -> str:
    """Return a key of all that a result depends on, and of our version: 32 hexadecimal digits.

    Of a path the bytes count, of a folder those of all files below it; of a detector its settings,
    the files that they name, and its weights; of all else what ``repr`` gives. Whatever is not done
    again because it was done before (results of ``infer``, images made ready for training, frames
    of an adaptation, views of ``annotate``) has such a key.
    """
    digest = hashlib.sha256(__version__.encode())
    for part in parts:
        text = repr(part)
        if isinstance(part, Path):
            files = sorted(part.rglob("*")) if part.is_dir() else [part]
            text = repr([(str(file.relative_to(part)), digest_of(file)) for file in files])
        if isinstance(part, Detector):
            settings, weights = part.settings, tensors_hash(part.state_dict())
            text = repr((part.name, settings, file_digests(settings.model_dump()), weights))
        digest.update(f"{len(text)} {text}".encode("utf-8", "surrogateescape"))
    return digest.hexdigest()[:32]


def paths_in(settings: object) -> list[Path]:
    """The files and folders that texts of nested settings name, as far as they exist.

    Weights that ship count by their name.
    """
    if isinstance(settings, Mapping):
        settings = list(settings.values())
    if isinstance(settings, list | tuple):
        return [path for value in settings for path in paths_in(value)]
    path = weights_path(str(settings)) if isinstance(settings, str | Path) else Path()
    return [path] if path.name and path.exists() else []


def file_digests(settings: object) -> dict[str, str]:
    """SHA-256 of the files that nested settings name, by path: ``paths_in`` without folders."""
    return {str(path): digest_of(path) for path in paths_in(settings) if path.is_file()}


def kept(path: Path, key: str | None, *names: str) -> Arrays | None:
    """The arrays that ``keep`` wrote under that key, those named or all; None where there are none.

    A file that is damaged, or of another key, holds none. Without a key any will do.
    """
    try:
        arrays = read_arrays(path, *names, *((KEY,) if names else ()))
    except (InputError, KeyError):
        return None
    own = arrays.pop(KEY, None)
    if own is None or key not in (None, bytes(own.tolist()).decode()):
        return None
    return arrays


def keep(path: Path, key: str, arrays: Arrays) -> None:
    """Write named tensors under a key, whole or not at all; folders are made."""
    make_folder(path.parent)
    write_arrays(path, {**arrays, KEY: torch.tensor(list(key.encode()), dtype=torch.uint8)})


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write named tensors as compressed NumPy archive, whole or not at all."""
    with atomic(path) as temporary, temporary.open("wb") as file:
        named = {name: value.numpy() for name, value in arrays.items()}
        np.savez_compressed(file, allow_pickle=False, **named)


def read_arrays(path: Path, *names: str) -> Arrays:
    """The named tensors of an archive, all where none is named; InputError for a damaged one."""
    try:
        with np.load(io.BytesIO(read_regular(path)), allow_pickle=False) as archive:
            arrays = {name: torch.from_numpy(archive[name]) for name in names or archive.files}
            if arrays:
                return arrays
            raise ValueError("the list of its members says that there are none")
    except Exception:  # zipfile, zlib and NumPy raise anything for foreign bytes
        raise InputError(path, "is damaged", "remove it; it will be made again") from None


def cached_arrays() -> Callable[..., Arrays]:
    """``read_arrays`` that keeps what it has read last; nobody may change what it gives."""
    return lru_cache(maxsize=CACHED)(read_arrays)
