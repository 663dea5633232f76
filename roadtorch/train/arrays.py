"""Named arrays on disk, as compressed NumPy archives; levels of [0,1] as bytes."""

import io
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from roadtorch.errors import InputError
from roadtorch.io.atomic import atomic
from roadtorch.io.bounded import read_regular

Arrays = dict[str, Tensor]

KEPT = 1000
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
    return lru_cache(maxsize=KEPT)(read_arrays)


def to_bytes(values: Tensor) -> Tensor:
    """Values in [0,1] as bytes: round(255 x)."""
    return values.mul(255).round_().to(torch.uint8)


def from_bytes(values: Tensor) -> Tensor:
    """Bytes as float32 in [0,1]."""
    return values.to(torch.float32).div_(255)
