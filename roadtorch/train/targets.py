"""Targets of whole-image networks: planes of layout, road and ego car with their weights. Ours."""

from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.layout.classes import HORIZONTAL, NUM_CLASSES, SKY
from roadtorch.train.config import Teacher

EGO_CERTAIN = 0.8
"""Probability from which a network's ego car counts, so that errors do not grow from run to run."""


class Targets(NamedTuple):
    """Targets of a network and their weights, in [0, 1].

    layout: (B, 3, H, W); layout_weight, road, road_weight, ego, ego_weight: (B, 1, H, W).
    """

    layout: Tensor
    layout_weight: Tensor
    road: Tensor
    road_weight: Tensor
    ego: Tensor
    ego_weight: Tensor

    @property
    def sky(self) -> Tensor:
        """Potential of sky, shape (B, 1, H, W)."""
        return self.layout[:, SKY : SKY + 1]

    @property
    def ground(self) -> Tensor:
        """Potential of ground, road and other, shape (B, 1, H, W)."""
        return self.layout[:, HORIZONTAL : HORIZONTAL + 1]


TARGET_PLANES = (NUM_CLASSES, 1, 1, 1, 1, 1)
"""Planes of the fields of ``Targets``."""


def split_targets(planes: Tensor) -> Targets:
    """Split stacked ``Targets`` (n, 8, H, W) into views."""
    return Targets(*planes.split(TARGET_PLANES, 1))


def make_targets(teacher: Tensor, network: Tensor | None, settings: Teacher) -> Targets:
    """Compute targets from the maps (B, 4, H, W) of the teacher and (B, 5, H, W) of a network.

    Weights are 0 or 1: 1 where the best class leads by ``margin`` and, with ``combine =
    "agreement"``, teacher and network agree. There is an ego car where the network is certain of
    one; there road is 0 with weight 1, and the layout has weight 0.
    """
    layout, road = teacher[:, :NUM_CLASSES], teacher[:, NUM_CLASSES:]
    agree, agree_road, ego = torch.ones_like(road), torch.ones_like(road), torch.zeros_like(road)
    if network is not None:
        network_layout, network_road, network_ego = network.split((NUM_CLASSES, 1, 1), 1)
        ego = (network_ego >= EGO_CERTAIN).to(road)
        if settings.combine == "agreement":
            agree = (best_class(layout) == best_class(network_layout)).to(road)
            agree_road = ((road >= 0.5) == (network_road >= 0.5)).to(road)
        weight = 1.0 if settings.combine == "teacher" else 0.5
        layout = torch.lerp(network_layout, layout, weight)
        road = torch.lerp(network_road, road, weight)
    best = layout.topk(2, dim=1).values
    sure = (best[:, :1] - best[:, 1:] >= settings.margin).to(road)
    street, known_road = 1 - ego, torch.maximum(agree_road, ego)
    known_layout = sure * agree * street
    return Targets(layout, known_layout, road * street, known_road, ego, torch.ones_like(ego))


def best_class(layout: Tensor) -> Tensor:
    """Return the index int64 (B, 1, H, W) of the largest potential (B, 3, H, W).

    ``argmax`` is ten times slower where the classes are not the last dimension.
    """
    return layout.max(1, keepdim=True).indices
