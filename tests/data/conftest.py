"""Files of labelled sets as tests write them, and a small CamVid of rendered streets."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.streets import scene, write_camvid

Content = str | bytes | np.ndarray | Image.Image


def write(path: Path, content: Content) -> Path:
    """Write text, bytes, an array of numbers or a picture, by the ending."""
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


@pytest.fixture
def camvid(tmp_path: Path) -> Path:
    scenes = {f"{drive}_{i}": scene(i, 24, 32) for i, drive in enumerate(("0001TP", "0006R0"))}
    write_camvid(tmp_path, "train", scenes)
    write_camvid(tmp_path, "val", {"0016E5_7": scene(7, 24, 32)})
    return tmp_path
