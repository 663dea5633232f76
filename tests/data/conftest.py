"""Writer of the files of labelled sets."""

from pathlib import Path

import numpy as np
from PIL import Image

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
