"""Ground truth from label images with one number, or one colour, per pixel."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import NamedTuple
from unicodedata import normalize

import numpy as np
import torch
from PIL import Image

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.decoding import (
    PNG_DEPTH,
    open_image,
    refuse_truncated,
    suppress_warnings,
    turn_upright,
    upright_size,
)
from roadtorch.base.errors import ConfigError, DatasetError
from roadtorch.base.image import IMAGE_SUFFIXES, UNREAD_SUFFIXES, warn_of_unread
from roadtorch.data.dataset import LabelledItem, Truth
from roadtorch.inputs.images import is_image_name

MAX_LISTED_VALUES = 5  # values, colours or images in a message
BYTE_VALUES = 256  # label numbers fit one byte
COLOUR = 1 << 24  # added to the 24 bits of a colour that is a value
LEVEL_BETWEEN = 128  # of the blurred borders in a JPEG
MAX_JPEG_TINT = 32  # largest difference of the channels of a grey pixel in a JPEG; ours


@dataclass(frozen=True)
class NumberLabels:
    """Coding of label images with one number (0 to 255) per pixel; reads their ground truth.

    Attributes:
        road: numbers of road.
        void: numbers of void.
        values: every number that may occur.
        layout: the layout class of each of ``values`` (255 for void); empty if there is no layout.
    """

    road: tuple[int, ...]
    void: tuple[int, ...]
    values: tuple[int, ...]
    layout: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        values = set(self.values)
        if not {*self.road, *self.void} <= values <= set(range(BYTE_VALUES)):
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
        values = _pack_colours(np.asarray(_open_labels(item.label, mode="RGB")))
        colours = _pack_colours(np.array(self.colours, np.uint8))
        return decode_labels(values, self.numbers, item.label, colours)


# --- finding ----------------------------------------------------------------------------


def pair_files(images: Path, labels: Path, ending: str = ".png") -> Iterator[tuple[Path, Path]]:
    """Yield the images of a folder, sorted, each with its label file in the folder ``labels``.

    ending: replaces the image's extension in the name of its label file.

    Raises:
        DatasetError: naming a missing folder or label file, and for two images with one label file.
    """
    by_label: dict[Path, Path] = {}
    if not labels.is_dir():
        raise DatasetError(labels, "does not exist", "check the folder's layout")
    for path in list_images(images):
        label = find_spelling(labels / f"{path.stem}{ending}")
        first = by_label.setdefault(label, path)
        if first != path:
            raise DatasetError(path, f"has the name of {first.name}", "rename one of the images")
    require_labels(list(by_label))
    yield from ((image, label) for label, image in by_label.items())


def list_images(folder: Path) -> list[Path]:
    """Return the images of a folder but for results of ``infer``, sorted; DatasetError for none."""
    if not folder.is_dir():
        raise DatasetError(folder, "does not exist", "check the folder's layout")
    files = sorted(folder.iterdir())
    warn_of_unread(folder, [path.name for path in files if path.suffix.lower() in UNREAD_SUFFIXES])
    if not (images := [path for path in files if is_image_name(path.name)]):
        raise DatasetError(folder, "holds no images", f"known endings: {' '.join(IMAGE_SUFFIXES)}")
    return images


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
        raise DatasetError(missing[0], message, missing_hint(missing[0], "label file"))


def missing_hint(path: Path, kind: str) -> str:
    """Return what to do about a missing file of an image, naming one of another ending."""
    siblings = sorted(path.parent.glob(f"{escape(path.stem)}.*")) if path.parent.is_dir() else []
    if not siblings:
        return f"every image needs its {kind}"
    return f"{siblings[0].name} is there, but not a {kind} by its ending: give {path.suffix}"


def is_image_file(path: Path) -> bool:
    """Return whether a file has the extension of an image and is not hidden."""
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")


# --- reading ----------------------------------------------------------------------------


class LabelPixels(NamedTuple):
    """Values (H, W) of a label image: whole numbers, truth values, or colours above COLOUR.

    palette: colours (red, green, blue, …) of which they are indices, if any.
    """

    values: np.ndarray
    palette: bytes = b""
    is_jpeg: bool = False


def read_label_pixels(path: Path, size: tuple[int, int] | None = None) -> LabelPixels:
    """Read a label image, upright.

    A grey of RGB, or of a palette of greys alone, is its level; in any other palette the index is
    the value. Levels of a JPEG, which blurs them, are 0, 255 or, in between, 128.

    size: required (height, width), checked before decoding.

    Raises:
        DatasetError: for a file of another size, that cannot be decoded, has floating-point
            numbers, colours of 16 bits or transparent pixels, and for a JPEG in colour or of low
            levels, which its noise may have changed.
    """
    image = _open_labels(path, size)
    pixels, is_jpeg = np.asarray(image), image.format == "JPEG"
    if pixels.dtype.kind == "f":
        raise DatasetError(path, "holds floating-point numbers", "give one whole number a pixel")
    may_be_transparent = image.has_transparency_data and not image.mode.startswith("I")
    if may_be_transparent and (np.asarray(image.convert("RGBA"))[..., 3] != 255).any():
        raise DatasetError(path, "has transparent pixels", "save it without transparency")
    if image.mode == "P":
        palette = np.array(image.getpalette("RGB"), np.uint8).reshape(-1, 3)
        if (palette != palette[:, :1]).any() or pixels.max(initial=0) >= len(palette):
            return LabelPixels(pixels, palette.tobytes())
        pixels = palette[pixels]
    elif image.mode in ("LA", "RGBA"):
        pixels = pixels[..., :-1]
    elif pixels.ndim == 3 and image.mode != "RGB":
        raise DatasetError(path, f"has the colours of {image.mode}", "give grey or RGB")
    if pixels.ndim == 3:
        grey = pixels[..., 0]
        if is_jpeg:
            if (np.ptp(pixels, -1) > MAX_JPEG_TINT).any():
                raise DatasetError(path, "is a JPEG in colour", "give a PNG")
        elif (is_colour := (pixels != grey[..., None]).any(-1)).any():
            grey = np.where(is_colour, _pack_colours(pixels), grey)
        pixels = grey
    if is_jpeg:
        if 0 < pixels.max(initial=0) < 64:
            raise DatasetError(path, f"is a JPEG with levels up to {pixels.max()}", "give a PNG")
        pixels = np.select([pixels < 64, pixels < 192], [0, LEVEL_BETWEEN], 255).astype(np.uint8)
    return LabelPixels(pixels, is_jpeg=is_jpeg)


def read_labels(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """Read the numbers (H, W) of a label image as ``read_label_pixels``; refuse colours."""
    labels = read_label_pixels(path, size).values
    if labels.max(initial=0) >= COLOUR:
        raise DatasetError(path, "is a colour image", "give one number per pixel")
    return labels.astype(np.uint8) if labels.dtype == np.bool_ else labels


def value_name(value: int) -> str:
    """Return a value of a label image as the command line has it: a number, or #rrggbb."""
    return str(value) if value < COLOUR else f"#{value - COLOUR:06x}"


def _open_labels(
    path: Path, size: tuple[int, int] | None = None, mode: str | None = None
) -> Image.Image:
    """Open a label image, decoded and upright; DatasetError as ``read_label_pixels`` raises it."""
    try:
        data = read_regular(path)
        with refuse_truncated(), suppress_warnings():
            image = open_image(data)
            form, (height, width) = image.format, upright_size(image)
            if size not in (None, (height, width)):
                hint = f"scale it to its image, {size[1]} by {size[0]}"
                raise DatasetError(path, f"has {width} by {height} pixels", hint)
            if form == "PNG" and data[PNG_DEPTH] == 16 and image.mode in ("RGB", "RGBA", "LA"):
                raise DatasetError(path, "has 16 bits a channel", "give 8, or one channel")
            upright = turn_upright(image)
            upright = upright.convert(mode) if mode else upright
            upright.format = form
            return upright
    except FileNotFoundError:
        raise DatasetError(path, "is missing", "every image needs its label file") from None
    except DatasetError:
        raise
    except Exception as error:
        message = f"cannot be decoded: {reason(error)}"
        raise DatasetError(path, message, "replace the file") from None


# --- meaning ----------------------------------------------------------------------------


def decode_labels(
    labels: np.ndarray, coding: NumberLabels, path: Path, values: np.ndarray | None = None
) -> Truth:
    """Return the ground truth of label numbers (H, W); DatasetError counting unknown numbers.

    values: those that stand for the values of the coding, such as colours.
    """
    meanings, codes = np.array(coding.values), np.array(coding.values) if values is None else values
    order = np.argsort(codes)
    index = order[np.searchsorted(codes, labels, sorter=order).clip(max=len(codes) - 1)]
    if (is_unknown := codes[index] != labels).any():
        names, counts = np.unique(labels[is_unknown], return_counts=True)
        listed = _list_counts([value_name(name) for name in names.tolist()], counts)
        hint = f"known: {', '.join(map(value_name, codes.tolist()))}"
        raise DatasetError(path, f"has unknown values {listed}", hint)
    road, valid = np.isin(meanings, coding.road), ~np.isin(meanings, coding.void)
    layout = torch.from_numpy(np.array(coding.layout, np.uint8)[index]) if coding.layout else None
    return Truth(torch.from_numpy(road[index]), torch.from_numpy(valid[index]), layout)


def _list_counts(names: list[str], counts: np.ndarray) -> str:
    """List the most frequent names with their numbers of pixels."""
    order = np.argsort(-counts, kind="stable")
    return list_names([f"{names[index]} ({counts[index]} pixels)" for index in order])


def list_names(names: Sequence[str]) -> str:
    """List the first names, and the number of others."""
    unlisted = len(names) - MAX_LISTED_VALUES
    ending = f" and {unlisted} others" if unlisted > 0 else ""
    return ", ".join(names[:MAX_LISTED_VALUES]) + ending


def _pack_colours(colours: np.ndarray) -> np.ndarray:
    """Pack each colour uint8 (..., 3) into one value, int32 (...)."""
    red, green, blue = np.moveaxis(colours.astype(np.int32), -1, 0)
    return red << 16 | green << 8 | blue | COLOUR
