"""The three classes of a layout: their numbers, names and colours, for all who speak of them."""

import torch
from torch import Tensor

from roadtorch.io.image import SKY_BLUE

SKY, VERTICAL, HORIZONTAL = range(3)

UNLABELLED = 255

NAMES = ("sky", "vertical", "horizontal")

CLASSES = len(NAMES)

LAYOUT_COLOURS = (SKY_BLUE, (213, 94, 0), (0, 158, 115))  # sky, vertical, horizontal


def layout_colours(labels: Tensor) -> Tensor:
    """Layout labels (H,W) as an image (3,H,W); what is not sky, vertical or horizontal is black."""
    table = torch.tensor([*LAYOUT_COLOURS, (0, 0, 0)]) / 255
    return table[labels.long().clamp(max=len(LAYOUT_COLOURS))].permute(2, 0, 1)
