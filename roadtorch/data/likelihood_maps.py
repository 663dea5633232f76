"""Likelihood maps and masks of other programs, scored like those of a detector."""

import io
import warnings
from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.errors import ConfigError, DatasetError, InputError, check_unit_range
from roadtorch.base.image import read_image
from roadtorch.base.settings import build_settings, read_settings_file
from roadtorch.data.label_images import find_spelling, read_labels
from roadtorch.detectors.detector import DetectorSettings, decide_mask

MAP_ENDINGS = (".png", ".likelihood.png", ".npy", ".likelihood.npy")

TOLERANCE = 1 / 255  # largest difference between a map of 8 bits and the same map in another format

MAX_LABELS = 32  # values of a map that may be a label image; ours: Cityscapes has 34 classes

INFER_CONFIG, MASK_ENDING = "config.toml", ".mask.png"
"""Settings that ``infer`` writes beside its maps, and the file name's end of its masks."""

DECISION_KEYS = ("threshold", "isolated", "seed_area")
"""Settings that turn a likelihood into a mask."""


def read_map(path: Path) -> Tensor:
    """Read a likelihood or a mask as float32 (H, W): a grey image of 8 or 16 bits, or a NumPy file.

    Where only 0 and 1 occur, as numbers or as indices of a palette, 1 is road; otherwise the
    largest level is 1. Raises InputError for a file that cannot be read, is coloured, or is not
    two-dimensional.
    """
    if path.suffix == ".npy":
        return _read_array(path)
    with suppress(DatasetError):  # a grey palette, or whatever reading the image reports
        labels = read_labels(path)
        if 0 <= labels.min() <= labels.max() <= 1:
            return torch.from_numpy(labels.astype(np.float32))
    return read_levels(path)


def read_levels(path: Path) -> Tensor:
    """Read a grey image as float32 (H, W), white being 1; raises as ``read_map``."""
    image = read_image(path)
    if (image != image[0]).any():
        raise InputError(path, "is a colour image", "give a grey one, bright where road is")
    return image[0]


def _read_array(path: Path) -> Tensor:
    try:
        values = np.load(io.BytesIO(read_regular(path)), allow_pickle=False)
    except Exception as error:  # NumPy raises anything for foreign bytes
        raise InputError(path, f"cannot be read: {reason(error)}", "replace the file") from None
    if not isinstance(values, np.ndarray):
        raise InputError(path, "is an archive of arrays", "give a single one")
    if values.ndim != 2 or values.dtype.kind not in "bfiu":
        message = f"holds {values.dtype} of shape {values.shape}"
        raise InputError(path, message, "give numbers (height, width)")
    if values.dtype.kind in "iu" and values.size and values.max() > 1:
        top = 255 if values.max() <= 255 and values.dtype != np.uint16 else 65535
        if values.min() < 0 or values.max() > top:
            message = f"has values from {values.min()} to {values.max()}"
            raise InputError(path, message, "give 0 and 1, levels up to 255 or 65535, or floats")
        values = values / top
    with np.errstate(over="ignore"):  # refused later, as a value out of [0,1]
        return torch.from_numpy(values.astype(np.float32))


def is_infer_folder(folder: Path) -> bool:
    """Return whether a folder holds results of ``infer``, which writes its settings there too."""
    return (folder / INFER_CONFIG).is_file()


def read_decision_settings(folder: Path) -> DetectorSettings:
    """Read the settings by which a folder's likelihoods become masks; 0.5 without config.toml."""
    if not is_infer_folder(folder):
        return DetectorSettings()
    values = read_settings_file(folder / INFER_CONFIG)
    try:
        settings = {key: values[key] for key in DECISION_KEYS if key in values}
        return build_settings(DetectorSettings, settings)
    except ConfigError as error:
        message = f"{error.where}: {error.problem}"
        raise ConfigError(folder / INFER_CONFIG, message, error.hint) from None


def read_or_decide_mask(
    folder: Path, names: Sequence[str], likelihood: Tensor, settings: DetectorSettings
) -> Tensor:
    """Return the mask bool (H, W) that ``infer`` wrote beside a map, or else one by the settings.

    ``infer`` may have used more than the likelihood: the ego car and the seed area. Raises
    InputError for a mask that cannot be read or has another size.
    """
    paths = [folder / f"{name}{MASK_ENDING}" for name in names] if is_infer_folder(folder) else []
    for path in paths:
        if path.is_file():
            mask = read_map(path) >= 0.5
            if mask.shape != likelihood.shape:
                hint = "make mask and likelihood in one run"
                raise InputError(path, "differs in size from its likelihood", hint)
            return mask
    return decide_mask(likelihood, settings)


def warn_of_labels(paths: Sequence[Path]) -> None:
    """Warn of a map with as few values as a label image has, but for those of a mask."""
    for path in paths:
        try:
            values = read_map(path).unique()
        except InputError:
            continue  # reported when it is scored
        if len(values) <= MAX_LABELS and not torch.isin(values, torch.tensor([0.0, 1.0])).all():
            message = f"{path} has only {len(values)} values; if they are numbers of classes, "
            warnings.warn(f"{message}write masks instead: 0 and 1, or 0 and 255", stacklevel=2)
            return


def find_maps(folder: Path, names: Sequence[str]) -> list[Path]:
    """Return the files of one image's map; names: possible stems."""
    paths = [find_spelling(folder / f"{name}{end}") for name in names for end in MAP_ENDINGS]
    return [path for path in paths if path.is_file()]


def read_likelihood_map(
    folder: Path, names: Sequence[str], sizes: Collection[tuple[int, int]]
) -> Tensor:
    """Read the map of one image, float32 (H, W) in [0, 1], of one of the allowed sizes.

    names: possible stems of the file. Raises InputError naming the file when it is missing, of
    another size, not grey, or has values outside [0, 1], and when two files of the image differ.
    """
    if not (present := find_maps(folder, names)):
        hint = f"every image needs a map, {' or '.join(MAP_ENDINGS)}"
        raise InputError(folder / f"{names[0]}{MAP_ENDINGS[0]}", "is missing", hint)
    path, *duplicates = present
    is_levels = is_infer_folder(folder) and path.suffix != ".npy"  # which may be 0 and 1
    likelihood = read_levels(path) if is_levels else read_map(path)
    if tuple(likelihood.shape) not in sizes:
        height, width = likelihood.shape
        allowed = " or ".join(dict.fromkeys(f"{columns} by {rows}" for rows, columns in sizes))
        raise InputError(path, f"is {width} by {height} pixels", f"it should be {allowed}")
    low, high = (float(bound) for bound in torch.aminmax(likelihood))
    check_unit_range(path, low, high, "keep to [0, 1]")
    for duplicate in duplicates:
        values = read_map(duplicate)
        if values.shape != likelihood.shape or not (values - likelihood).abs().max() <= TOLERANCE:
            raise InputError(duplicate, f"differs from {path.name}", "remove one of them")
    return likelihood
