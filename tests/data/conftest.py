"""Writer of the files of labelled sets, reader of maps."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from torch import Tensor

from roadtorch.data.likelihood_maps import find_maps, open_maps
from roadtorch.detectors.entry import DetectorSettings

Content = str | bytes | np.ndarray | Image.Image


def write(path: Path, content: Content) -> Path:
    """Write text, bytes, an array of numbers or an image, by the ending."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, np.ndarray) and path.suffix == ".npy":
        np.save(path, content, allow_pickle=True)
    elif isinstance(content, np.ndarray):
        Image.fromarray(content).save(path)
    elif isinstance(content, Image.Image):
        content.save(path)
    else:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def read_likelihood_map(
    folder: Path, names: Sequence[str], sizes: Sequence[tuple[int, int]]
) -> Tensor:
    """Read one map, whose folder has no others."""
    with warnings.catch_warnings(action="ignore"):  # they have few values
        maps = open_maps(folder, DetectorSettings(), find_maps(folder, names))
    return maps.read_likelihood(names, sizes)
