"""Rendered images with their truth, for scores; the renderer does not need torch."""

from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch import read_image
from roadtorch.data.dataset import Truth
from train.worlds.truth import ROAD, VOID


def read_world(file: Path) -> tuple[Tensor, Truth]:
    """Return the image (3, H, W) and the truth of FOLDER/images/NAME.jpg, whose layout is codes."""
    path = file.parents[1] / "truth" / f"{file.stem}.png"
    code = torch.from_numpy(np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))
    return read_image(file), Truth(code == ROAD, code != VOID, code)
