"""The three classes of a layout, for all who speak of them, and two opinions on them as one."""

from typing import Annotated

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.image import SKY_BLUE

SKY, VERTICAL, HORIZONTAL = range(3)

UNLABELLED = 255

NAMES = ("sky", "vertical", "horizontal")

CLASSES = len(NAMES)

LAYOUT_COLOURS = (SKY_BLUE, (213, 94, 0), (0, 158, 115))  # sky, vertical, horizontal


def layout_colours(labels: Tensor) -> Tensor:
    """Layout labels (H,W) as an image (3,H,W); what is not sky, vertical or horizontal is black."""
    table = torch.tensor([*LAYOUT_COLOURS, (0, 0, 0)]) / 255
    return table[labels.long().clamp(max=len(LAYOUT_COLOURS))].permute(2, 0, 1)


MIN_POTENTIAL = 1e-4
"""Potentials count as at least this large: neither opinion alone can veto a class."""

Share = Annotated[
    float,
    Field(ge=0, le=1, description="weight of the network against the labels made in this image"),
]
"""A setting: the ``share`` of ``pooled`` where the other opinion is a network's."""


def pooled(first: Tensor, second: Tensor, share: float) -> Tensor:
    """Logarithmic opinion pool of potentials (3,…) in [0,1]; sums to 1 over the classes.

    share: weight of the second opinion, from 0 (the first alone) to 1. Genest and Zidek,
    "Combining Probability Distributions", Statistical Science 1986.
    """
    logs, others = (opinion.clamp_min(MIN_POTENTIAL).log() for opinion in (first, second))
    return ((1 - share) * logs + share * others).softmax(0)
