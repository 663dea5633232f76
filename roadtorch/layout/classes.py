"""The three classes of a layout: numbers, names, colours, and the pooling of two predictions."""

from typing import Annotated

import torch
from pydantic import Field
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


MIN_POTENTIAL = 1e-4
"""Lower bound of potentials in a pool, so that no prediction alone vetoes a class."""

NetworkWeight = Annotated[
    float, Field(ge=0, le=1, description="weight of the network against the machine labels")
]
"""Setting: the ``weight`` of ``opinion_pool``, where the second prediction is a network's."""


def opinion_pool(first: Tensor, second: Tensor, weight: float) -> Tensor:
    """Pool two potentials (3, …) in [0, 1] by a weighted geometric mean, of sum 1 over the classes.

    weight: of the second, 0 to 1. Logarithmic opinion pool: Genest and Zidek, "Combining
    Probability Distributions", Statistical Science 1986.
    """
    logs = [potentials.clamp_min(MIN_POTENTIAL).log() for potentials in (first, second)]
    return ((1 - weight) * logs[0] + weight * logs[1]).softmax(0)
