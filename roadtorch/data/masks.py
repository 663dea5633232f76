"""Masks of road as people have them: label images or COCO, by value or category."""

import shlex
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from unicodedata import normalize

import numpy as np
import torch

from roadtorch.base.errors import ConfigError, DatasetError
from roadtorch.data.correction_formats import NO_REGION, fill_regions, read_coco
from roadtorch.data.corrections import read_image_size
from roadtorch.data.dataset import Truth
from roadtorch.data.events import LABEL_NAMES
from roadtorch.data.label_images import (
    LEVEL_BETWEEN,
    LabelPixels,
    is_image_file,
    list_names,
    read_label_pixels,
    value_name,
)

MASK_TAILS = ("", "_mask", ".mask", "_road", "_label", "_labels", "_L")
"""Ends of a mask's name, before the suffix, after its image's name without suffix."""


MaskValues = tuple[Sequence[str], Sequence[str]]
"""Values that are road and void where no others are named; 0 is neither, others are unknown."""

MASK_VALUES: MaskValues = ("1", "255", "road"), ("127", "128", "void")

BOTH = "has both 1 and 255:"  # of which one may be void

_Readers = dict[Path, tuple[Path, Callable[[], LabelPixels]]]
"""File and reader of the mask of each image."""


@dataclass(frozen=True, eq=False)
class Mask:
    """Mask of one image; read: returns its values. road, void: those that mean this."""

    image: Path
    read: Callable[[], LabelPixels]
    road: tuple[int, ...]
    void: tuple[int, ...]
    file: Path = Path()

    @property
    def truth(self) -> Truth:
        """Road, and what is not void; DatasetError where the mask cannot be read."""
        values = self.read().values
        road, void = (torch.from_numpy(np.isin(values, part)) for part in (self.road, self.void))
        return Truth(road, road | ~void)

    @property
    def labels(self) -> np.ndarray:
        """Indices in ``LABEL_NAMES``, uint8, shape (H, W); raises as ``truth``."""
        road, void, not_road = map(LABEL_NAMES.index, ("road", "void", "not_road"))
        truth = self.truth
        return np.where(truth.valid, np.where(truth.road, road, not_road), void).astype(np.uint8)


def read_masks(
    path: Path,
    images: Mapping[str, Path],
    road: Sequence[str] = (),
    void: Sequence[str] = (),
    defaults: MaskValues = MASK_VALUES,
    requires_road: bool = True,
) -> tuple[list[Mask], str]:
    """Return masks of images, decoded when they are used, and what is road in them, in words.

    The values of all masks decide. One that cannot be read decides nothing; it fails when used.

    Args:
        path: folder of label images named like their images, or a COCO file.
        images: files of the images by their relative name with extension.
        road: values (numbers, colours as #rrggbb) or categories of COCO that are road.
        void: those that do not count; by default, if ``road`` is, those of ``defaults``.
        defaults: what is road and void by default.
        requires_road: whether masks without any road are an error.

    Raises:
        ConfigError: for a value that is to be both.
        DatasetError: without a mask of an image, where none can be read, and for values of unknown
            meaning.
    """
    if clash := {*road} & {*void}:
        raise ConfigError("--void", f"{min(clash)} is also --road", "give it one meaning")
    readers, names = _read_regions(path, images) if path.is_file() else _pair(path, images)
    counts, numbers, palettes, has_jpeg = _count_values(path, readers, names)
    road_names = road or [name for name in defaults[0] if name not in void]
    void_names = [*(void or (() if road else defaults[1])), *[str(LEVEL_BETWEEN)] * has_jpeg]
    meaning = {
        "road": [name for name in road_names if name in counts],
        "not road": [name for name in counts if name not in {*road_names, *void_names}],
        "void": [name for name in dict.fromkeys(void_names) if name in counts],
    }
    listed = _list_values(counts, counts)
    frequent = [shlex.quote(n) for n, _ in counts.most_common(3) if n != NO_REGION][:2]
    hint = f"try --road {' or --road '.join(frequent)}, and --void for values that do not count"
    if problem := _find_problem(counts, palettes, road, meaning, bool(names)):
        hint = "try --road 1 --void 255, or --road 1 --road 255" if problem == BOTH else hint
        raise DatasetError(path, f"{problem} {listed}", hint)
    if requires_road and not meaning["road"]:
        raise DatasetError(path, f"has no road, but {listed}", "name it with --road")
    is_road, is_void = (tuple(numbers[name] for name in meaning[part]) for part in ("road", "void"))
    masks = [Mask(image, read, is_road, is_void, file) for image, (file, read) in readers.items()]
    texts = [f"{key} is {_list_values(counts, part)}" for key, part in meaning.items() if part]
    bare = [name for name, image in images.items() if image not in readers]
    without = f", none for {list_names(bare)}" if bare else ""
    summary = f"{len(masks)} of {len(images)} images have a mask{without}; {'; '.join(texts)}"
    return masks, summary


def _count_values(
    path: Path, readers: _Readers, names: list[str]
) -> tuple[Counter[str], dict[str, int], list[bytes], bool]:
    """Return pixels and number of each value, by its name; the palettes; whether any is a JPEG.

    Raises DatasetError where no mask can be read, and for different palettes.
    """
    counts, numbers = Counter[str](), dict[str, int]()
    errors, palettes, jpegs = list[DatasetError](), dict[bytes, Path](), 0
    for file, read in readers.values():
        try:
            pixels = read()
        except DatasetError as error:
            errors.append(error)
            continue
        jpegs += pixels.is_jpeg
        if pixels.palette:
            palettes.setdefault(pixels.palette, file)
        values, sizes = np.unique(pixels.values + np.uint8(0), return_counts=True)
        for number, size in zip(values.tolist(), sizes.tolist(), strict=True):
            name = names[number] if names else value_name(number)
            counts[name] += size
            numbers[name] = number
    if len(errors) == len(readers):
        raise errors[0]
    longest = max(palettes, key=len, default=b"")
    for palette, file in palettes.items():
        if not longest.startswith(palette):
            message = f"and {palettes[longest].name} have different palettes"
            raise DatasetError(file, message, "save one number, or one colour, a pixel")
    if jpegs:
        text = f"{jpegs} masks are JPEG, which blurs borders: levels from 64 to 191 are void"
        warnings.warn(f"{path}: {text} (write PNG)", stacklevel=3)
    return counts, numbers, list(palettes), bool(jpegs)


def _find_problem(
    counts: Counter[str],
    palettes: Sequence[bytes],
    road: Sequence[str],
    meaning: Mapping[str, list[str]],
    is_coco: bool,
) -> str:
    """Return what is wrong with the meaning of the values; empty if nothing is."""
    if missing := [name for name in road if name not in counts]:
        return f"has no value {missing[0]}, but"
    if is_coco:
        return "" if meaning["road"] else "has no road, but"
    if road:
        return ""
    if unknown := [name for name in meaning["not road"] if name != "0"]:
        return f"has values of unknown meaning, such as {unknown[0]}:"
    if any(any(palette[:3]) for palette in palettes):
        return "has masks in a palette whose first colour is not black:"
    return BOTH if {"1", "255"} <= {*meaning["road"]} else ""


def _list_values(counts: Counter[str], names: Iterable[str]) -> str:
    """List values with their fractions of all pixels, the most frequent first."""
    total, ordered = counts.total(), sorted(names, key=lambda name: -counts[name])
    return list_names([f"{name} ({100 * counts[name] / total:.1f} %)" for name in ordered])


def _read_regions(path: Path, images: Mapping[str, Path]) -> tuple[_Readers, list[str]]:
    """Return the readers of images with regions in a COCO file, and the categories by value."""
    sizes = {name: size for name, image in images.items() if (size := _read_size(image))}
    regions, categories = read_coco(path, sizes)
    readers = {
        images[name]: (path, partial(fill_regions, path, name, sizes[name], part))
        for name, part in regions.items()
        if part
    }
    if not readers:
        raise DatasetError(path, "has no region on any of the images", "label some of them")
    return readers, [name for name, _ in categories]


def _pair(folder: Path, images: Mapping[str, Path]) -> tuple[_Readers, list[str]]:
    """Return the readers of the label images; no names of values."""
    readers: _Readers = {}
    owners: dict[Path, Path] = {}
    files_below = cache(_list_by_stem)
    for name, image in images.items():
        by_stem, stem = files_below(folder / Path(name).parent), normalize("NFC", Path(name).stem)
        candidates = [file for tail in MASK_TAILS for file in by_stem.get(f"{stem}{tail}", ())]
        files = [file for file in candidates if file != image]
        if len(files) > 1:
            message = f"and {files[1].name} are masks of {image.name}"
            raise DatasetError(files[0], message, "keep one of them")
        if files:
            if (owner := owners.setdefault(files[0], image)) != image:
                message = f"is the mask of {owner.name} and of {image.name}"
                raise DatasetError(files[0], message, "rename one of the images")
            readers[image] = (files[0], partial(read_label_pixels, files[0], _read_size(image)))
    if not readers:
        message = f"has a mask for none of {len(images)} images, such as {next(iter(images), '')}"
        hint = "name masks like their images, NAME.png or NAME_mask.png, or give a COCO file"
        raise DatasetError(folder, message, hint)
    return readers, []


def _read_size(image: Path) -> tuple[int, int] | None:
    """Read (height, width) of an image; None for one that will fail when it is used."""
    with suppress(DatasetError):
        return read_image_size(image)


def _list_by_stem(folder: Path) -> Mapping[str, list[Path]]:
    """Return the image files of a folder, if there is one, by their name without suffix in NFC."""
    files = defaultdict[str, list[Path]](list)
    for file in sorted(folder.iterdir()) if folder.is_dir() else ():
        if is_image_file(file):
            files[normalize("NFC", file.stem)].append(file)
    return files
