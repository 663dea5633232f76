"""What a network for whole pictures should say, where that counts, and its error. Ours."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.layout.classes import CLASSES
from roadtorch.train.batches import Batch
from roadtorch.train.config import PictureTraining, Rounds, Teacher


class Targets(NamedTuple):
    """What a network should say, and where it counts. In [0,1].

    layout: (B,3,H,W); layout_weight, road, road_weight: (B,1,H,W).
    """

    layout: Tensor
    layout_weight: Tensor
    road: Tensor
    road_weight: Tensor


def targets_of(
    teacher: Tensor, network: Tensor | None, settings: Teacher, rounds: Rounds
) -> Targets:
    """Targets from the maps (B,4,H,W) of the teacher and, from round 2 on, of the last network.

    The road's likelihood is moved so that ``road_threshold`` becomes 0.5. A pixel counts where
    the best class leads by ``margin``; with agreement, only where both name the same class, or
    both say road, or both say no road.
    """
    layout, road = teacher[:, :CLASSES], centred(teacher[:, CLASSES:], settings.road_threshold)
    agree = agree_road = torch.ones_like(road)
    if network is not None:
        other, other_road = network[:, :CLASSES], network[:, CLASSES:]
        if rounds.combine == "agreement":
            agree = (layout.argmax(1, True) == other.argmax(1, True)).to(road)
            agree_road = ((road >= 0.5) == (other_road >= 0.5)).to(road)
        own = {"network": 0.0, "teacher": 1.0}.get(rounds.combine, 0.5)
        layout, road = torch.lerp(other, layout, own), torch.lerp(other_road, road, own)
    best = layout.topk(2, dim=1).values
    sure = (best[:, :1] - best[:, 1:] >= settings.margin).to(road)
    sure_road = ((2 * road - 1).abs() >= settings.road_margin).to(road)
    return Targets(layout, sure * agree, road, sure_road * agree_road)


def centred(likelihood: Tensor, threshold: float) -> Tensor:
    """Likelihoods in [0,1] whose odds are divided by those of the threshold."""
    yes, no = likelihood * (1 - threshold), (1 - likelihood) * threshold
    return yes / (yes + no)


def target_error(scores: Tensor, targets: Targets, road_weight: float) -> Tensor:
    """Cross-entropy of scores (B,4,H,W), summed over pictures, mean over all their pixels."""
    layout = -(targets.layout * scores[:, :CLASSES].log_softmax(1)).sum(1, keepdim=True)
    road = F.binary_cross_entropy_with_logits(scores[:, CLASSES:], targets.road, reduction="none")
    error = layout * targets.layout_weight + road_weight * road * targets.road_weight
    return error.mean((1, 2, 3)).sum()


class PictureError:
    """The error function of one training: targets as they are, or hardened to one class."""

    def __init__(self, training: PictureTraining) -> None:
        self._targets = training.teacher.targets
        self._road_weight = training.road_weight

    def __call__(self, network: nn.Module, batch: Batch) -> Tensor:
        """Sum over the batch's pictures of their mean error."""
        targets = Targets(*batch.targets.split([CLASSES, 1, 1, 1], 1))
        if self._targets == "hard":
            best = F.one_hot(targets.layout.argmax(1), CLASSES).permute(0, 3, 1, 2)
            road = (targets.road >= 0.5).to(targets.road)
            targets = targets._replace(layout=best.to(targets.layout), road=road)
        return target_error(network(batch.inputs), targets, self._road_weight)
