"""What a network for whole pictures should say, where that counts, and its error. Ours."""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.layout.classes import CLASSES
from roadtorch.layout.picture_network import EGO, ROAD
from roadtorch.road.fusion import log_odds
from roadtorch.road.otsu import centred_odds
from roadtorch.train.batches import Batch
from roadtorch.train.config import HeadWeights, PictureTraining, Rounds, Teacher

KNOWN = 0.25
"""How far from 0.5 the ego car is known: its maps are bytes, and bent where they are reframed."""

CERTAIN = 0.8
"""From here on a network's ego car is one, below it is none: what it half believes would grow
from round to round."""


class Targets(NamedTuple):
    """What a network should say, and where it counts. In [0,1].

    layout: (B,3,H,W); layout_weight, road, road_weight, ego, ego_weight: (B,1,H,W).
    """

    layout: Tensor
    layout_weight: Tensor
    road: Tensor
    road_weight: Tensor
    ego: Tensor
    ego_weight: Tensor


PLANES = (CLASSES, 1, 1, 1, 1, 1)
"""Planes of the parts of ``Targets``."""


def targets_of(
    teacher: Tensor, ego: Tensor, network: Tensor | None, settings: Teacher, rounds: Rounds
) -> Targets:
    """Targets from the maps (B,4,H,W) of the teacher and, from round 2 on, of the last network.

    ego: (B,1,H,W), the ego car where the footage shows it: 1 ego, 0 not, 0.5 unknown. Where it
    is unknown there is none at first, later what the last network's maps (B,5,H,W) are certain
    of. The road's likelihood is moved so that its threshold becomes 0.5. A pixel counts where
    the best class leads by ``margin``; with agreement, only where both name the same class, or
    both say road, or both say no road. On the ego car the road is 0 and counts, the layout not.
    """
    layout, road = teacher[:, :CLASSES], centred_as(teacher[:, CLASSES:], settings)
    agree = agree_road = torch.ones_like(road)
    if network is not None:
        other, other_road = network[:, :CLASSES], network[:, ROAD : ROAD + 1]
        if rounds.combine == "agreement":
            agree = (best_class(layout) == best_class(other)).to(road)
            agree_road = ((road >= 0.5) == (other_road >= 0.5)).to(road)
        own = {"network": 0.0, "teacher": 1.0}.get(rounds.combine, 0.5)
        layout, road = torch.lerp(other, layout, own), torch.lerp(other_road, road, own)
    said = torch.zeros_like(ego) if network is None else (network[:, EGO:] >= CERTAIN).to(ego)
    ego = torch.where((ego - 0.5).abs() < KNOWN, said, ego)
    best = layout.topk(2, dim=1).values
    sure = (best[:, :1] - best[:, 1:] >= settings.margin).to(road)
    sure_road = ((2 * road - 1).abs() >= settings.road_margin).to(road)
    sure_ego = ((2 * ego - 1).abs() >= KNOWN).to(road)
    street = (ego < 0.5 + KNOWN).to(road)
    known_road = torch.maximum(sure_road * agree_road, 1 - street)
    return Targets(layout, sure * agree * street, road * street, known_road, ego, sure_ego)


def best_class(layout: Tensor) -> Tensor:
    """The class int64 (B,1,H,W) that leads in potentials (B,3,H,W).

    ``argmax`` says the same, ten times slower where the classes are not the last dimension.
    """
    return layout.max(1, keepdim=True).indices


def centred_as(likelihood: Tensor, settings: Teacher) -> Tensor:
    """Likelihoods (B,1,H,W) moved so that what parts road from background becomes 0.5."""
    centre = math.log(settings.road_threshold / (1 - settings.road_threshold))
    odds = [centred_odds(each, centre, settings.centre) for each in log_odds(likelihood)]
    return torch.stack(odds).sigmoid()


def target_error(scores: Tensor, targets: Targets, weights: HeadWeights) -> Tensor:
    """Cross-entropy of scores (B,5,H,W), summed over pictures, mean over all their pixels."""
    layout = -(targets.layout * scores[:, :CLASSES].log_softmax(1)).sum(1, keepdim=True)
    road = _binary(scores[:, ROAD : ROAD + 1], targets.road) * targets.road_weight
    ego = _binary(scores[:, EGO:], targets.ego) * targets.ego_weight
    error = layout * targets.layout_weight + weights.road * road + weights.ego * ego
    return error.mean((1, 2, 3)).sum()


def _binary(scores: Tensor, targets: Tensor) -> Tensor:
    return F.binary_cross_entropy_with_logits(scores, targets, reduction="none")


class PictureError:
    """The error function of one training: targets as they are, or hardened to one class."""

    def __init__(self, training: PictureTraining) -> None:
        self._targets = training.teacher.targets
        self._weights = training.heads

    def __call__(self, network: nn.Module, batch: Batch) -> Tensor:
        """Sum over the batch's pictures of their mean error."""
        scores = network(batch.inputs).float()
        small = F.adaptive_avg_pool2d(batch.targets, scores.shape[-2:])
        targets = Targets(*small.split(PLANES, 1))
        if self._targets == "hard":
            best = F.one_hot(best_class(targets.layout)[:, 0], CLASSES).permute(0, 3, 1, 2)
            road = (targets.road >= 0.5).to(targets.road)
            targets = targets._replace(layout=best.to(targets.layout), road=road)
        return target_error(scores, targets, self._weights)
