"""Targets of whole-image networks: planes of layout, road and ego car with their weights. Ours."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.layout.classes import HORIZONTAL, NUM_CLASSES, SKY
from roadtorch.road.bayes import centred_odds, log_odds
from roadtorch.train.config import Teacher

EGO_KNOWN = 0.25
"""Least distance of an ego value from 0.5, unknown, to count: values are interpolated by warps."""

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


def make_targets(
    teacher: Tensor, ego: Tensor, network: Tensor | None, settings: Teacher
) -> Targets:
    """Compute targets from the maps (B, 4, H, W) of the teacher and (B, 5, H, W) of a network.

    ego: ego car in the footage, (B, 1, H, W): 1 ego, 0 not, 0.5 unknown; there it is 1 where the
    network is certain of one, else 0. Road likelihoods are shifted so that their threshold becomes
    0.5. Weights are 0 or 1: 1 where the best class leads by ``margin`` and, with ``combine =
    "agreement"``, teacher and network agree. On the ego car road is 0 with weight 1, and the layout
    has weight 0.
    """
    layout, road = teacher[:, :NUM_CLASSES], centre_likelihood(teacher[:, NUM_CLASSES:], settings)
    agree, agree_road, guess = torch.ones_like(road), torch.ones_like(road), torch.zeros_like(ego)
    if network is not None:
        network_layout, network_road, network_ego = network.split((NUM_CLASSES, 1, 1), 1)
        guess = (network_ego >= EGO_CERTAIN).to(ego)
        if settings.combine == "agreement":
            agree = (best_class(layout) == best_class(network_layout)).to(road)
            agree_road = ((road >= 0.5) == (network_road >= 0.5)).to(road)
        weight = 1.0 if settings.combine == "teacher" else 0.5
        layout = torch.lerp(network_layout, layout, weight)
        road = torch.lerp(network_road, road, weight)
    ego = torch.where((ego - 0.5).abs() < EGO_KNOWN, guess, ego)
    best = layout.topk(2, dim=1).values
    sure = (best[:, :1] - best[:, 1:] >= settings.margin).to(road)
    sure_ego = ((2 * ego - 1).abs() >= EGO_KNOWN).to(road)
    street = (ego < 0.5 + EGO_KNOWN).to(road)
    known_road = torch.maximum(agree_road, 1 - street)
    return Targets(layout, sure * agree * street, road * street, known_road, ego, sure_ego)


def best_class(layout: Tensor) -> Tensor:
    """Return the index int64 (B, 1, H, W) of the largest potential (B, 3, H, W).

    ``argmax`` is ten times slower where the classes are not the last dimension.
    """
    return layout.max(1, keepdim=True).indices


def centre_likelihood(likelihood: Tensor, settings: Teacher) -> Tensor:
    """Shift likelihoods (B, 1, H, W) so that the threshold of road becomes 0.5."""
    centre = math.log(settings.road_threshold / (1 - settings.road_threshold))
    centred = [centred_odds(odds, centre, settings.otsu_weight) for odds in log_odds(likelihood)]
    return torch.stack(centred).sigmoid()
