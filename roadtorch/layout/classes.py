"""The three classes of a layout: numbers, names and colours."""

import torch
from torch import Tensor

from roadtorch.base.image import SKY_BLUE

SKY, VERTICAL, HORIZONTAL = range(3)

UNLABELLED = 255

CLASS_NAMES = ("sky", "vertical", "horizontal")

NUM_CLASSES = len(CLASS_NAMES)

LAYOUT_COLOURS = (SKY_BLUE, (213, 94, 0), (0, 158, 115))  # sky, vertical, horizontal


def colour_layout(labels: Tensor) -> Tensor:
    """Return layout labels (H, W) as an image (3, H, W); unlabelled pixels are black."""
    table = torch.tensor([*LAYOUT_COLOURS, (0, 0, 0)]) / 255
    return table[labels.long().clamp(max=len(LAYOUT_COLOURS))].permute(2, 0, 1)
