"""Two opinions on the layout of a picture as one."""

from typing import Annotated

from pydantic import Field
from torch import Tensor

LEAST = 1e-4
"""Potentials count as at least this large: neither opinion alone can veto a class."""

Share = Annotated[
    float,
    Field(ge=0, le=1, description="weight of the network against the labels made in this picture"),
]
"""A setting: the ``share`` of ``pooled`` where the other opinion is a network's."""


def pooled(one: Tensor, other: Tensor, share: float) -> Tensor:
    """Logarithmic opinion pool of potentials (3,…) in [0,1]; sums to 1 over the classes.

    share: weight of the other opinion, from 0 (the one alone) to 1. Genest and Zidek,
    "Combining Probability Distributions", Statistical Science 1986.
    """
    logs = (1 - share) * one.clamp_min(LEAST).log() + share * other.clamp_min(LEAST).log()
    return logs.softmax(0)
