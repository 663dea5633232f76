"""Label pictures, and a small CamVid of rendered streets."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roadtorch.scenes.street import render_scene
from tests.streets import write_camvid


def write_png(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


@pytest.fixture
def camvid(tmp_path) -> Path:
    scenes = {
        f"{drive}_{i}": render_scene(i, 24, 32) for i, drive in enumerate(("0001TP", "0006R0"))
    }
    write_camvid(tmp_path, "train", scenes)
    write_camvid(tmp_path, "val", {"0016E5_7": render_scene(7, 24, 32)})
    return tmp_path
