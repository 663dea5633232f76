"""Likelihood maps and masks of other programs, scored like those of a detector."""

import io
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.errors import ConfigError, DatasetError, InputError, check_unit_range
from roadtorch.base.image import MASK_ENDING
from roadtorch.base.settings import INFER_CONFIG, build_settings, read_settings_file
from roadtorch.data.label_images import COLOUR, find_spelling, missing_hint, read_label_pixels
from roadtorch.detectors.entry import DetectorSettings
from roadtorch.detectors.mask import decide_mask

MAP_ENDINGS = (".png", ".likelihood.png", ".npy", ".likelihood.npy")

TOLERANCE = 1 / 255  # largest difference between a map of 8 bits and the same map in another format

MAX_LABELS = 32  # values of maps that may be label images; ours: Cityscapes has 34 classes

INFER_WHITE = {"uint8": 255, "uint16": 65535}
"""Levels that are 1 in the maps and masks of ``infer``, which may hold 0 and 1 alone."""

DECISION_KEYS = {"threshold", "isolated", "seed_area"}
"""Settings that turn a likelihood into a mask."""


def read_map_levels(path: Path) -> tuple[str, np.ndarray]:
    """Read a grey image or a NumPy file: the type of numbers and the numbers as stored (H, W)."""
    if path.suffix == ".npy":
        return _read_array(path)
    try:
        pixels = read_label_pixels(path)
    except DatasetError as error:
        raise InputError(error.where, error.problem, error.hint) from None
    values, palette = pixels.values, pixels.palette
    largest = values.max(initial=0)
    if largest >= COLOUR or (palette and (largest > 1 or any(palette[:3]))):
        raise InputError(path, "is a colour image", "give a grey one, bright where road is")
    if pixels.is_jpeg:
        raise InputError(path, "is a JPEG", "give a PNG")
    return "palette" if palette else values.dtype.name, values


def _read_array(path: Path) -> tuple[str, np.ndarray]:
    try:
        values = np.load(io.BytesIO(read_regular(path)), allow_pickle=False)
    except Exception as error:  # NumPy raises anything for foreign bytes
        raise InputError(path, f"cannot be read: {reason(error)}", "replace the file") from None
    if not isinstance(values, np.ndarray):
        raise InputError(path, "is an archive of arrays", "give a single one")
    if values.ndim != 2 or values.dtype.kind not in "bfiu" or not values.size:
        message = f"holds {values.dtype} of shape {values.shape}"
        raise InputError(path, message, "give numbers (height, width)")
    return f"{values.dtype.name} in NumPy files", values


def read_map(path: Path, white: Mapping[str, int]) -> Tensor:
    """Read a likelihood or a mask as float32 (H, W) in [0, 1].

    white: the level that is 1, by the type of numbers. Raises InputError as ``read_map_levels``,
    and for values out of range.
    """
    dtype, values = read_map_levels(path)
    top = white.get(dtype, 1)
    low, high = float(values.min()), float(values.max())
    if top == 1:
        check_unit_range(path, low, high, "keep to [0, 1]")
    elif low < 0 or high > top:
        raise InputError(path, f"has values from {low:g} to {high:g}", f"keep to [0, {top}]")
    return torch.from_numpy((values / top if top > 1 else values).astype(np.float32))


def is_infer_folder(folder: Path) -> bool:
    """Return whether a folder holds results of ``infer``, which writes its settings there too."""
    return (folder / INFER_CONFIG).is_file()


def read_decision_settings(folder: Path) -> DetectorSettings:
    """Read the settings by which a folder's likelihoods become masks; 0.5 without config.toml."""
    if not is_infer_folder(folder):
        return DetectorSettings()
    path = folder / INFER_CONFIG
    values = read_settings_file(path)
    try:
        decision = {key: values[key] for key in DECISION_KEYS & values.keys()}
        return build_settings(DetectorSettings, decision)
    except ConfigError as error:
        raise ConfigError(path, f"{error.where}: {error.problem}", error.hint) from None


@dataclass(frozen=True)
class MapFolder:
    """Maps of images in a folder, and the settings by which they become masks.

    white: the level that is 1, by the type of numbers (``open_maps``).
    """

    folder: Path
    decision: DetectorSettings
    white: Mapping[str, int]

    def read_mask(self, names: Sequence[str], likelihood: Tensor) -> Tensor:
        """Return the mask bool (H, W) that ``infer`` wrote beside a map, or else by the settings.

        ``infer`` may have used more than the likelihood: the ego car and the seed area. Raises
        InputError for a mask that cannot be read or has another size.
        """
        is_infer = is_infer_folder(self.folder)
        paths = [self.folder / f"{name}{MASK_ENDING}" for name in names] if is_infer else []
        for path in paths:
            if path.is_file():
                mask = read_map(path, INFER_WHITE) >= 0.5
                if mask.shape != likelihood.shape:
                    hint = "make mask and likelihood in one run"
                    raise InputError(path, "differs in size from its likelihood", hint)
                return mask
        return decide_mask(likelihood, self.decision)

    def read_likelihood(self, names: Sequence[str], sizes: Collection[tuple[int, int]]) -> Tensor:
        """Read the map of one image, float32 (H, W) in [0, 1], of one of the allowed sizes.

        names: possible stems of the file. Raises InputError naming the file when it is missing, of
        another size, not grey, or has values outside [0, 1], and when two files of the image
        differ.
        """
        if not (present := find_maps(self.folder, names)):
            path = self.folder / f"{names[0]}{MAP_ENDINGS[0]}"
            raise InputError(path, "is missing", missing_hint(path, "map"))
        path, *duplicates = present
        likelihood = read_map(path, self.white)
        if tuple(likelihood.shape) not in sizes:
            height, width = likelihood.shape
            allowed = " or ".join(dict.fromkeys(f"{columns} by {rows}" for rows, columns in sizes))
            raise InputError(path, f"is {width} by {height} pixels", f"it should be {allowed}")
        for duplicate in duplicates:
            values = read_map(duplicate, self.white)
            is_equal = values.shape == likelihood.shape
            if not is_equal or not (values - likelihood).abs().max() <= TOLERANCE:
                raise InputError(duplicate, f"differs from {path.name}", "remove one of them")
        return likelihood


def open_maps(folder: Path, decision: DetectorSettings, paths: Iterable[Path]) -> MapFolder:
    """Open the maps at paths. Of each type of numbers, all maps show which level is 1.

    It is that of ``infer`` in its folders; else 1 where only 0 and 1 occur, 65535 for 16 bits and
    for larger numbers, or 255. Warns of a type with as few values as label images have.
    """
    if is_infer_folder(folder):
        return MapFolder(folder, decision, INFER_WHITE)
    largest, white = dict[str, np.ndarray](), dict[str, int]()  # the largest values of each type
    for path in paths:
        with suppress(InputError):  # reported when it is scored
            dtype, values = read_map_levels(path)
            values, levels = values[np.isfinite(values)], largest.get(dtype, values.ravel()[:0])
            new = values if len(levels) <= MAX_LABELS else values.max(keepdims=True, initial=0)
            largest[dtype] = np.union1d(levels, new)[-MAX_LABELS - 1 :]
    for dtype, values in largest.items():
        if values.dtype.kind in "iu":
            top, is_16_bit = values.max(), dtype.startswith("uint16")
            white[dtype] = 1 if top <= 1 else 65535 if top > 255 or is_16_bit else 255
        if len(values) <= MAX_LABELS and not {*values.tolist()} <= {0, 1, white.get(dtype, 1)}:
            message = f"{folder} has only {len(values)} values in maps of {dtype}; if they are "
            message += "numbers of classes, write masks instead: 0 and 1, or 0 and 255"
            warnings.warn(message, stacklevel=2)
    return MapFolder(folder, decision, white)


def find_maps(folder: Path, names: Sequence[str]) -> list[Path]:
    """Return the files of one image's map; names: possible stems."""
    paths = [find_spelling(folder / f"{name}{end}") for name in names for end in MAP_ENDINGS]
    return [path for path in paths if path.is_file()]
