"""Truth from label pictures: finding them; one number a pixel, or one colour a pixel."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from roadtorch.data.dataset import Item, Truth
from roadtorch.errors import ConfigError, DatasetError
from roadtorch.io.bounded import read_regular, reason
from roadtorch.io.decoding import open_picture, without_warnings
from roadtorch.io.image import SUFFIXES
from roadtorch.layout.classes import UNLABELLED

SHOWN = 5  # unknown values or colours named in an error

CODES = 256  # label numbers fit one byte


@dataclass(frozen=True)
class NumberLabels:
    """The truth in label pictures with one number (0…255) a pixel.

    road, void: the numbers of these two; values: every number that may occur; layout: the
    layout class of each of ``values`` (255 for void), or empty for a set without layout;
    exclusive: numbers of which a file may use one only.
    Raises ConfigError when these do not fit each other.
    """

    road: tuple[int, ...]
    void: tuple[int, ...]
    values: tuple[int, ...]
    layout: tuple[int, ...] = ()
    exclusive: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not {*self.road, *self.void, *self.exclusive} <= set(self.values) <= set(range(CODES)):
            what = "has numbers of road or void that are not among its values, or none of 0…255"
            raise ConfigError("NumberLabels", what, "list every number in values")
        if set(self.road) & set(self.void):
            raise ConfigError("NumberLabels", "has a number that is road and void", "choose one")
        if self.layout and len(self.layout) != len(self.values):
            what = f"has {len(self.layout)} layout classes for {len(self.values)} values"
            raise ConfigError("NumberLabels", what, "give one for each")

    def truth(self, item: Item) -> Truth:
        """Read the item's label picture; DatasetError naming and counting unknown numbers."""
        return decode_labels(read_labels(item.label), self, item.label)


@dataclass(frozen=True)
class ColourLabels:
    """The truth in label pictures with one colour a pixel.

    colours: every (red, green, blue), 0…255, that may occur. numbers: what they mean; a
    colour's number is its place in ``colours``.
    """

    colours: tuple[tuple[int, int, int], ...]
    numbers: NumberLabels

    def truth(self, item: Item) -> Truth:
        """Read the item's label picture; DatasetError naming and counting unknown colours."""
        indices = colour_indices(read_colours(item.label), self.colours, item.label)
        return decode_labels(indices, self.numbers, item.label)


# --- finding ----------------------------------------------------------------------------


def pairs(images: Path, labels: Path, ending: str = ".png") -> Iterator[tuple[Path, Path]]:
    """Every picture of a folder, sorted, with its label file: its name with this ending.

    Raises DatasetError naming the first thing that is missing: a folder, any picture, a
    label file; and for two pictures with the same label file.
    """
    for folder in (images, labels):
        if not folder.is_dir():
            raise DatasetError(folder, "does not exist", "check the folder's layout")
    found = [path for path in sorted(images.iterdir()) if is_picture(path)]
    if not found:
        raise DatasetError(images, "holds no pictures", f"known endings: {' '.join(SUFFIXES)}")
    by_label = {labels / f"{path.stem}{ending}": path for path in reversed(found)}
    for path in found:
        if (first := by_label[labels / f"{path.stem}{ending}"]) != path:
            raise DatasetError(path, f"has the name of {first.name}", "one picture a name")
    missing = [label for label in by_label if not label.is_file()]
    if missing:
        what = f"is missing, {len(missing)} of {len(found)} label files in all"
        raise DatasetError(missing[-1], what, "every picture needs its label file")
    yield from ((by_label[label], label) for label in reversed(by_label))


def is_picture(path: Path) -> bool:
    """Whether a file's name is that of a picture; hidden files are none."""
    return path.suffix.lower() in SUFFIXES and not path.name.startswith(".")


# --- reading ----------------------------------------------------------------------------


def read_labels(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """The numbers (H,W) in a label picture; palette files keep their indices.

    size: that it has to have, looked at before anything is decoded. Raises DatasetError for a
    file of another size, that cannot be decoded or has different colour channels.
    """
    labels = _read(path, None, size)
    if labels.ndim == 3:
        grey = labels[..., 0]
        opaque = labels.shape[2] % 2 == 1 or (labels[..., -1] == 255).all()
        bands = labels[..., : (labels.shape[2] - 1) | 1]  # without alpha
        if not opaque or (bands != grey[..., None]).any():
            raise DatasetError(path, "is a colour picture", "give one number a pixel")
        labels = grey
    return labels.astype(np.uint8) if labels.dtype == np.bool_ else labels


def read_colours(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """The colours uint8 (H,W,3) of a label picture; size and errors as for ``read_labels``."""
    return _read(path, "RGB", size)


def _read(path: Path, mode: str | None, size: tuple[int, int] | None) -> np.ndarray:
    try:
        with open_picture(read_regular(path)) as picture, without_warnings():
            if size not in (None, (picture.height, picture.width)):
                what = f"has {picture.width} by {picture.height} pixels"
                raise DatasetError(path, what, f"its picture has {size[1]} by {size[0]}")
            return np.asarray(picture.convert(mode) if mode else picture)
    except FileNotFoundError:
        raise DatasetError(path, "is missing", "every picture needs its label file") from None
    except DatasetError:
        raise
    except Exception as problem:
        what = f"cannot be decoded: {reason(problem)}"
        raise DatasetError(path, what, "replace the file") from None


# --- meaning ----------------------------------------------------------------------------


def decode_labels(labels: np.ndarray, coding: NumberLabels, path: Path) -> Truth:
    """Turn label numbers (H,W) into truth; DatasetError naming and counting unknown ones."""
    values, counts = _count(labels)
    strange = ~np.isin(values, coding.values)
    if strange.any():
        named = _counted([str(value) for value in values[strange]], counts[strange])
        known = ", ".join(map(str, coding.values))
        raise DatasetError(path, f"has unknown values {named}", f"known: {known}")
    mixed = [value for value in coding.exclusive if value in values]
    if len(mixed) > 1:
        what = f"has both {mixed[0]} and {mixed[1]}, each of which means road"
        void = " or ".join(map(str, coding.void)) or "not known"
        raise DatasetError(path, what, f"use one of them; void is {void}")
    found = [torch.from_numpy(table.take(labels)) for table in _tables(coding)]
    return Truth(found[0], found[1], found[2] if coding.layout else None)


def colour_indices(
    colours: np.ndarray, known: tuple[tuple[int, int, int], ...], path: Path
) -> np.ndarray:
    """The place of each pixel's colour in ``known``: uint8 (H,W) from uint8 (H,W,3).

    Raises DatasetError naming unknown colours as "r g b" and counting their pixels.
    """
    codes = _codes(colours)
    table = _codes(np.array(known, np.uint8))
    order = np.argsort(table)
    near = order[np.searchsorted(table[order], codes).clip(max=len(table) - 1)]
    if (strange := table[near] != codes).any():
        values, counts = np.unique(codes[strange], return_counts=True)
        named = [f"{v >> 16} {v >> 8 & 255} {v & 255}" for v in values.tolist()]
        what = f"has unknown colours {_counted(named, counts)}"
        raise DatasetError(path, what, f"the set has {len(known)} colours, given as red green blue")
    return near.astype(np.uint8)


def _codes(colours: np.ndarray) -> np.ndarray:
    wide = colours.astype(np.int32)
    return wide[..., 0] << 16 | wide[..., 1] << 8 | wide[..., 2]


def _count(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The values that occur and how often; without sorting where they fit one byte."""
    if labels.dtype != np.uint8:
        return np.unique(labels, return_counts=True)
    counts = np.bincount(labels.ravel(), minlength=CODES)
    values = counts.nonzero()[0]
    return values, counts[values]


def _counted(names: list[str], counts: np.ndarray) -> str:
    """The most frequent names first, each with its pixels."""
    order = np.argsort(-counts, kind="stable")[:SHOWN]
    named = ", ".join(f"{names[i]} ({counts[i]} pixels)" for i in order)
    return named + (f" and {len(names) - SHOWN} others" if len(names) > SHOWN else "")


@lru_cache
def _tables(coding: NumberLabels) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Look-up tables over the numbers 0…255: is road, is valid, layout class."""
    road = np.zeros(CODES, np.bool_)
    valid = np.ones(CODES, np.bool_)
    layout = np.full(CODES, UNLABELLED, np.uint8)
    road[list(coding.road)] = True
    valid[list(coding.void)] = False
    if coding.layout:
        layout[list(coding.values)] = coding.layout
    return road, valid, layout
