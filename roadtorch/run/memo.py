"""Caches on disk: named tensors in .npz files, under a hash of everything they depend on."""

import hashlib
import io
import os
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from roadtorch.base.atomic import atomic_write, file_digest, make_folder
from roadtorch.base.bounded import read_regular
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.version import __version__
from roadtorch.detectors.detector import Detector
from roadtorch.layout.weights import hash_tensors, weights_path

Arrays = dict[str, Tensor]

KEY_NAME = "key"  # name of the array that holds the cache key

MAX_CACHED_FILES = 1000
"""Number of files kept in memory, about 0.2 MB each: reading and unpacking a file takes a quarter
of the time of augmenting it."""


def cache_key(*parts: object) -> str:
    """Return a cache key of all inputs of a result and roadtorch's version: 32 hexadecimal digits.

    A path is hashed by its bytes, a folder by those of all files below it; a detector by its
    settings, the files that they name, its weights and runtime; anything else by its ``repr``.
    """
    digest = hashlib.sha256(__version__.encode())
    for part in parts:
        text = repr(part)
        if isinstance(part, Path):
            files = sorted(part.rglob("*")) if part.is_dir() else [part]
            text = repr([(str(file.relative_to(part)), file_digest(file)) for file in files])
        if isinstance(part, Detector):
            settings, weights = part.settings, hash_tensors(part.state_dict())
            files = file_digests(settings.model_dump())
            text = repr((part.name, settings, files, weights, part.runtime))
        digest.update(f"{len(text)} {text}".encode("utf-8", "surrogateescape"))
    return digest.hexdigest()[:32]


def find_paths(settings: object) -> list[Path]:
    """Return the existing files and folders named in nested settings, shipped weights included."""
    if isinstance(settings, Mapping):
        settings = list(settings.values())
    if isinstance(settings, list | tuple):
        return [path for value in settings for path in find_paths(value)]
    if not isinstance(settings, str | Path):
        return []
    try:
        path = weights_path(str(settings))
    except ConfigError:  # any other string, or a file by its bare name
        path = Path(settings)
    return [path] if path.name and os.path.exists(path) else []


def file_digests(settings: object) -> list[str]:
    """Return the SHA-256 of the files named in nested settings (no folders), wherever they are."""
    return [file_digest(path) for path in find_paths(settings) if path.is_file()]


def read_cached(path: Path, key: str | None, *names: str) -> Arrays | None:
    """Read cached tensors, all or those named; None if missing, damaged or of another key."""
    try:
        arrays = read_arrays(path, *names, *((KEY_NAME,) if names else ()))
    except (InputError, KeyError):
        return None
    stored = arrays.pop(KEY_NAME, None)
    if stored is None or key not in (None, bytes(stored.tolist()).decode()):
        return None
    return arrays


def write_cached(path: Path, key: str, arrays: Arrays) -> None:
    """Write named tensors with their cache key atomically; create missing folders."""
    make_folder(path.parent)
    write_arrays(path, {**arrays, KEY_NAME: torch.tensor(list(key.encode()), dtype=torch.uint8)})


def write_arrays(path: Path, arrays: Arrays) -> None:
    """Write named tensors atomically as a compressed .npz archive."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        named = {name: value.numpy() for name, value in arrays.items()}
        np.savez_compressed(file, allow_pickle=False, **named)


def read_arrays(path: Path, *names: str) -> Arrays:
    """Read the named tensors of an .npz archive, by default all; InputError where it is damaged."""
    try:
        with np.load(io.BytesIO(read_regular(path)), allow_pickle=False) as archive:
            arrays = {name: torch.from_numpy(archive[name]) for name in names or archive.files}
            if arrays:
                return arrays
            raise ValueError("the archive has no members")
    except Exception:  # zipfile, zlib and NumPy raise various errors for damaged bytes
        raise InputError(path, "is damaged", "remove it; it will be made again") from None


def make_cached_reader() -> Callable[..., Arrays]:
    """Return ``read_arrays`` with an LRU cache; callers must not change the tensors in place."""
    return lru_cache(maxsize=MAX_CACHED_FILES)(read_arrays)
