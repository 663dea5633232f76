"""Masks of road as people have them: label images or COCO, by value or category."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from roadtorch.base.errors import DatasetError
from roadtorch.data.correction_formats import read_coco_categories
from roadtorch.data.corrections import read_image_size
from roadtorch.data.events import LABEL_NAMES
from roadtorch.data.label_images import find_spelling, read_labels

MASK_ENDINGS = (
    ".png",
    "_mask.png",
    ".mask.png",
    "_road.png",
    "_label.png",
    "_labels.png",
    "_L.png",
)
"""Endings of a mask's name after that of its image without suffix."""

ROAD_VALUES, VOID_VALUES, OTHER_VALUES = ("1", "255", "road"), ("127", "128", "void"), ("0",)
"""Values that are road, void and neither where no others are named."""

MAX_VALUES = 6  # values in a message


@dataclass(frozen=True, eq=False)
class Mask:
    """Mask of one image; read: returns its numbers (H, W). road, void: those that mean this."""

    image: Path
    read: Callable[[], np.ndarray]
    road: tuple[int, ...]
    void: tuple[int, ...]

    @property
    def labels(self) -> np.ndarray:
        """Indices in ``LABEL_NAMES``, uint8, shape (H, W)."""
        numbers, labels = self.read(), map(LABEL_NAMES.index, ("road", "void", "not_road"))
        is_road, is_void = (np.isin(numbers, values) for values in (self.road, self.void))
        road, void, not_road = labels
        return np.where(is_road, road, np.where(is_void, void, not_road)).astype(np.uint8)


def read_masks(
    path: Path, images: Mapping[str, Path], road: Sequence[str] = (), void: Sequence[str] = ()
) -> tuple[list[Mask], str]:
    """Read the masks of images, check pairs, sizes and values, and describe them.

    Args:
        path: folder of label images named like their images, or a COCO file.
        images: files of the images by their relative name with extension.
        road: values, or categories of COCO, that are road; by default 1, 255 or "road".
        void: those that do not count; by default, if ``road`` is, 127, 128 and "void".

    Returns:
        The masks, decoded when they are used, and what is road in them, in words.

    Raises:
        DatasetError: without a mask of an image, for a mask that cannot be read or has another
            size, for values of unknown meaning, and where none of them is road.
    """
    names = list[str]()
    if path.is_file():
        image_sizes = {name: read_image_size(image) for name, image in images.items()}
        regions, categories = read_coco_categories(path, image_sizes)
        names = [name for name, _ in categories]
        readers = {images[name]: partial(np.asarray, values) for name, values in regions.items()}
    else:
        readers = _pair_masks(path, images)
    counts, numbers = Counter[str](), dict[str, int]()
    for read in readers.values():
        values, sizes = np.unique(read(), return_counts=True)
        for number, size in zip(values.tolist(), sizes.tolist(), strict=True):
            name = names[number] if names else str(number)
            counts[name] += size
            numbers[name] = number
    road_names = road or [name for name in ROAD_VALUES if name not in void]
    void_names = void or (() if road else VOID_VALUES)
    not_road = [name for name in counts if name not in {*road_names, *void_names}]
    meaning = {
        "road": [name for name in road_names if name in counts],
        "not road": not_road,
        "void": [name for name in void_names if name in counts],
    }
    listed, hint = _list_values(counts, counts), "name values with --road, and --void for no label"
    if missing := [name for name in road if name not in counts]:
        raise DatasetError(path, f"has no value {missing[0]}, but {listed}", hint)
    if not road and (unknown := [n for n in not_road if n not in {*names, *OTHER_VALUES}]):
        message = f"has values of unknown meaning, such as {unknown[0]}: {listed}"
        raise DatasetError(path, message, hint)
    if not meaning["road"]:
        raise DatasetError(path, f"has no road, but {listed}", hint)
    if not road and {"1", "255"} <= {*meaning["road"]}:
        raise DatasetError(path, f"has both 1 and 255: {listed}", hint)
    codes = [tuple(numbers[name] for name in meaning[part]) for part in ("road", "void")]
    masks = [Mask(image, read, *codes) for image, read in readers.items()]
    texts = [f"{key} is {_list_values(counts, part)}" for key, part in meaning.items() if part]
    return masks, f"{len(masks)} of {len(images)} images have a mask; {'; '.join(texts)}"


def _list_values(counts: Counter[str], names: Iterable[str]) -> str:
    """List values with their fractions of all pixels, the most frequent first."""
    total = counts.total()
    ordered = sorted(names, key=lambda name: -counts[name])
    texts = [f"{name} ({100 * counts[name] / total:.1f} %)" for name in ordered]
    unlisted = f" and {len(texts) - MAX_VALUES} others" if len(texts) > MAX_VALUES else ""
    return ", ".join(texts[:MAX_VALUES]) + unlisted


def _pair_masks(folder: Path, images: Mapping[str, Path]) -> dict[Path, Callable[[], np.ndarray]]:
    """Return the reader of each image's mask."""
    readers = {}
    for name, image in images.items():
        stem = folder / Path(name).with_suffix("")
        paths = [find_spelling(Path(f"{stem}{ending}")) for ending in MASK_ENDINGS]
        files = [file for file in paths if file.is_file() and file != image]
        if len(files) > 1:
            message = f"and {files[1].name} are masks of {image.name}"
            raise DatasetError(files[0], message, "keep one of them")
        if files:
            readers[image] = partial(read_labels, files[0], read_image_size(image))
    if not readers:
        message = f"has a mask for none of {len(images)} images"
        hint = "name masks like their images, NAME.png or NAME_mask.png, or give a COCO file"
        raise DatasetError(folder, message, hint)
    return readers
