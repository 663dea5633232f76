"""Ground truth from label images with one number, or one colour, per pixel."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from unicodedata import normalize

import numpy as np
import torch

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.decoding import open_image, refuse_truncated, suppress_warnings
from roadtorch.base.errors import ConfigError, DatasetError
from roadtorch.base.image import IMAGE_SUFFIXES, UNREAD_SUFFIXES, warn_of_unread
from roadtorch.data.dataset import LabelledItem, Truth
from roadtorch.layout.classes import UNLABELLED

MAX_LISTED_VALUES = 5  # unknown values or colours named in an error
BYTE_VALUES = 256  # label numbers fit one byte


@dataclass(frozen=True)
class NumberLabels:
    """Coding of label images with one number (0 to 255) per pixel; reads their ground truth.

    Attributes:
        road: numbers of road.
        void: numbers of void.
        values: every number that may occur.
        layout: the layout class of each of ``values`` (255 for void); empty if there is no layout.
        exclusive: numbers of which a file may use only one.
    """

    road: tuple[int, ...]
    void: tuple[int, ...]
    values: tuple[int, ...]
    layout: tuple[int, ...] = ()
    exclusive: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        values = set(self.values)
        if not {*self.road, *self.void, *self.exclusive} <= values <= set(range(BYTE_VALUES)):
            message = "has numbers that are not among its values, or values outside 0 to 255"
            raise ConfigError("NumberLabels", message, "list every number in values")
        if set(self.road) & set(self.void):
            raise ConfigError("NumberLabels", "has a number that is road and void", "choose one")
        if self.layout and len(self.layout) != len(self.values):
            message = f"has {len(self.layout)} layout classes for {len(self.values)} values"
            raise ConfigError("NumberLabels", message, "give one for each")

    def truth(self, item: LabelledItem) -> Truth:
        """Read the item's label image; DatasetError naming and counting unknown numbers."""
        return decode_labels(read_labels(item.label), self, item.label)


@dataclass(frozen=True)
class ColourLabels:
    """Coding of label images with one colour per pixel; reads their ground truth.

    Attributes:
        colours: every (red, green, blue), 0 to 255, that may occur.
        numbers: their meaning; the number of a colour is its index in ``colours``.
    """

    colours: tuple[tuple[int, int, int], ...]
    numbers: NumberLabels

    def truth(self, item: LabelledItem) -> Truth:
        """Read the item's label image; DatasetError naming and counting unknown colours."""
        indices = self.colour_indices(_read_pixels(item.label, "RGB"), item.label)
        return decode_labels(indices, self.numbers, item.label)

    def colour_indices(self, pixels: np.ndarray, path: Path) -> np.ndarray:
        """Return the index in ``colours`` of each pixel: uint8 (H, W) from colours uint8 (H, W, 3).

        Raises DatasetError naming unknown colours as "r g b" and counting their pixels.
        """
        codes = _pack_colours(pixels)
        indices = _colour_table(self.colours)[codes]
        if (is_unknown := indices == len(self.colours)).any():
            values, counts = np.unique(codes[is_unknown], return_counts=True)
            names = [f"{code >> 16} {code >> 8 & 255} {code & 255}" for code in values.tolist()]
            hint = f"the set has {len(self.colours)} colours, written red green blue"
            raise DatasetError(path, f"has unknown colours {_list_counts(names, counts)}", hint)
        return indices


# --- finding ----------------------------------------------------------------------------


def pair_files(images: Path, labels: Path, ending: str = ".png") -> Iterator[tuple[Path, Path]]:
    """Yield the images of a folder, sorted, each with its label file in the folder ``labels``.

    ending: replaces the image's extension in the name of its label file.

    Raises:
        DatasetError: naming a missing folder or label file, and for two images with one label file.
    """
    for folder in (images, labels):
        if not folder.is_dir():
            raise DatasetError(folder, "does not exist", "check the folder's layout")
    by_label: dict[Path, Path] = {}
    files = sorted(images.iterdir())
    warn_of_unread(images, [path.name for path in files if path.suffix.lower() in UNREAD_SUFFIXES])
    for path in filter(is_image_file, files):
        label = find_spelling(labels / f"{path.stem}{ending}")
        first = by_label.setdefault(label, path)
        if first != path:
            raise DatasetError(path, f"has the name of {first.name}", "rename one of the images")
    if not by_label:
        raise DatasetError(images, "holds no images", f"known endings: {' '.join(IMAGE_SUFFIXES)}")
    require_labels(list(by_label))
    yield from ((image, label) for label, image in by_label.items())


def find_spelling(path: Path) -> Path:
    """Return the file of a path, or else the one whose name differs in its Unicode form alone.

    macOS may have written ü as u and a mark (NFD), where others write one letter (NFC).
    """
    if path.name.isascii() or path.exists() or not path.parent.is_dir():
        return path
    name = normalize("NFC", path.name)
    spellings = (file for file in path.parent.iterdir() if normalize("NFC", file.name) == name)
    return next(spellings, path)


def require_labels(paths: Sequence[Path]) -> None:
    """Raise DatasetError naming the first missing label file, and the number of missing ones."""
    missing = [path for path in paths if not path.is_file()]
    if missing:
        message = f"is missing, {len(missing)} of {len(paths)} label files in all"
        raise DatasetError(missing[0], message, "every image needs its label file")


def is_image_file(path: Path) -> bool:
    """Return whether a file has the extension of an image and is not hidden."""
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")


# --- reading ----------------------------------------------------------------------------


def read_labels(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """Read a label image, integers (H, W); palette files keep their indices.

    size: required (height, width), checked before decoding.

    Raises:
        DatasetError: for a file of another size, that cannot be decoded or is coloured.
    """
    labels = _read_pixels(path, None, size)
    if labels.ndim == 3:
        grey = labels[..., 0]
        opaque = labels.shape[2] % 2 == 1 or (labels[..., -1] == 255).all()
        bands = labels[..., : (labels.shape[2] - 1) | 1]  # without alpha
        if not opaque or (bands != grey[..., None]).any():
            raise DatasetError(path, "is a colour image", "give one number per pixel")
        labels = grey
    return labels.astype(np.uint8) if labels.dtype == np.bool_ else labels


def _read_pixels(path: Path, mode: str | None, size: tuple[int, int] | None = None) -> np.ndarray:
    try:
        with refuse_truncated(), open_image(read_regular(path)) as image, suppress_warnings():
            if size not in (None, (image.height, image.width)):
                hint = f"its image has {size[1]} by {size[0]}"
                raise DatasetError(path, f"has {image.width} by {image.height} pixels", hint)
            return np.asarray(image.convert(mode) if mode else image)
    except FileNotFoundError:
        raise DatasetError(path, "is missing", "every image needs its label file") from None
    except DatasetError:
        raise
    except Exception as error:
        message = f"cannot be decoded: {reason(error)}"
        raise DatasetError(path, message, "replace the file") from None


# --- meaning ----------------------------------------------------------------------------


def decode_labels(labels: np.ndarray, coding: NumberLabels, path: Path) -> Truth:
    """Return the ground truth of label numbers (H, W); DatasetError counting unknown numbers."""
    if labels.dtype == np.uint8:  # without sorting
        counts = np.bincount(labels.ravel(), minlength=BYTE_VALUES)
        values = counts.nonzero()[0]
        counts = counts[values]
    else:
        values, counts = np.unique(labels, return_counts=True)
    is_unknown = ~np.isin(values, coding.values)
    if is_unknown.any():
        names = _list_counts([str(value) for value in values[is_unknown]], counts[is_unknown])
        hint = f"known: {', '.join(map(str, coding.values))}"
        raise DatasetError(path, f"has unknown values {names}", hint)
    mixed = [value for value in coding.exclusive if value in values]
    if len(mixed) > 1:
        void = " or ".join(map(str, coding.void)) or "not known"
        message = f"has both {mixed[0]} and {mixed[1]}, and both mean road"
        raise DatasetError(path, message, f"use one of them; void is {void}")
    road, valid, layout = (torch.from_numpy(table.take(labels)) for table in _lookup_tables(coding))
    return Truth(road, valid, layout if coding.layout else None)


def _list_counts(names: list[str], counts: np.ndarray) -> str:
    """List the most frequent names with their numbers of pixels."""
    order = np.argsort(-counts, kind="stable")[:MAX_LISTED_VALUES]
    text = ", ".join(f"{names[index]} ({counts[index]} pixels)" for index in order)
    unlisted = len(names) - len(order)
    return text + (f" and {unlisted} others" if unlisted else "")


def _pack_colours(colours: np.ndarray) -> np.ndarray:
    """Pack each colour uint8 (..., 3) into one int32 (...)."""
    red, green, blue = np.moveaxis(colours.astype(np.int32), -1, 0)
    return red << 16 | green << 8 | blue


@lru_cache(maxsize=4)
def _colour_table(colours: tuple[tuple[int, int, int], ...]) -> np.ndarray:
    """Return the index of each of 2²⁴ colours, uint8; ``len(colours)`` for unknown ones."""
    table = np.full(2**24, len(colours), np.uint8)
    table[_pack_colours(np.array(colours, np.uint8))] = np.arange(len(colours))
    return table


@lru_cache
def _lookup_tables(coding: NumberLabels) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lookup tables over the numbers 0 to 255: is road, is valid, layout class."""
    road = np.zeros(BYTE_VALUES, np.bool_)
    valid = np.ones(BYTE_VALUES, np.bool_)
    layout = np.full(BYTE_VALUES, UNLABELLED, np.uint8)
    road[list(coding.road)] = True
    valid[list(coding.void)] = False
    if coding.layout:
        layout[list(coding.values)] = coding.layout
    return road, valid, layout
