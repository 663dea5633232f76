"""A running mean of a network's weights: steadier than the last step's. Ours."""

import copy
from typing import Generic, TypeVar

import torch
from torch import nn

Network = TypeVar("Network", bound=nn.Module)

FIRST = 10
"""Steps over which the mean begins: the first steps' weights are soon forgotten."""


class AverageWeights(Generic[Network]):
    """The running mean of a network's weights over its steps; Polyak and Juditsky, 1992.

    Each step keeps the share ``kept`` of the mean, in the beginning less.
    """

    def __init__(self, network: Network, kept: float) -> None:
        self.network = copy.deepcopy(network)
        self._kept = kept

    @torch.no_grad()
    def add(self, network: nn.Module, steps: int) -> None:
        """Take in the weights that a network has after ``steps`` steps."""
        kept = min(self._kept, steps / (steps + FIRST)) if self._kept else 0.0
        for mean, weight in zip(self.network.parameters(), network.parameters(), strict=True):
            mean.lerp_(weight, 1 - kept)
