"""How far a mask can be trusted: the F it is expected to have, from what the detector knows. Ours.

A good mask is the same at any threshold, has a good F if the likelihood is right, and begins at a
seed area that is road to the network: a ridge regression of F on these signs over labelled
images of many cameras. And there is a road at all where little of the image is in doubt: a
logistic regression on rendered worlds with and without a road (``python -m train.calibrate
trust``, which tells what both are worth on what had no part).
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.settings import Settings
from roadtorch.imaging.levels import above


class Signs(NamedTuple):
    """What tells a good mask from a bad one; each from 0 to 1."""

    steady: float
    """Overlap (IoU) of what is road at a low and at a high threshold (``LOW_AND_HIGH``)."""
    expected: float
    """F of the mask if the likelihood is right: pixels are road as often as it says."""
    seed: float
    """Mean of the network's road in the seed area."""
    vague: float
    """Mean entropy of the likelihood, in bits."""


LOW_AND_HIGH = (0.2, 0.8)

WEIGHTS = Signs(0.12, 0.62, 0.11, 0.0)  # of the signs, in the expected F; ``CONSTANT`` is added

CONSTANT = 0.163

USUAL = Signs(0.71, 0.9, 0.98, 0.2)
"""The mean signs over the images on which the weights were chosen."""

ROAD_STEADY, ROAD_VAGUE, ROAD_THERE = 4.71, -6.17, 1.06
"""Log odds that there is a road at all: weights of the signs ``steady`` and ``vague``, constant."""

ENOUGH = 0.7
"""Probability that there is a road from which on nothing is taken off the expected F."""

NO_ROAD = "hardly anything in the image looks like road"

REASONS = (
    "another threshold gives another mask",
    "much of the mask is not likely road",
    "the seed area looks like a vehicle, a wall or grass",
    "much of the image is neither road nor not",
)
"""What is said when a sign is worse than usual, in the order of the signs."""


class TrustSettings(Settings):
    """When a mask is called doubtful."""

    least: float = Field(
        default=0.6, ge=0, le=1, description="expected F below which a mask is doubtful"
    )


class Judgement(NamedTuple):
    """trust: the expected F of a mask, in [0,1]. doubt: why it is low, in words; else empty."""

    trust: float
    doubt: str


def signs_of(likelihood: Tensor, mask: Tensor, cues: Mapping[str, Tensor]) -> Signs:
    """The signs of a mask bool (H,W) made of a likelihood (H,W) in [0,1].

    cues: ``learned_road``, ``seed_area`` and ``ego``, all (H,W). In an exported graph all may have
    a dimension more, and signs are tensors (N,).
    """
    free = weights_of(~cues["ego"])
    inside = free * weights_of(mask)
    low, high = (total(weights_of(above(likelihood, level)), free) for level in LOW_AND_HIGH)
    road, right = (total(likelihood, area) for area in (free, inside))
    seed = weights_of(cues["seed_area"])
    signs: list[Any] = [
        high / low.clamp(min=1),
        2 * right / (total(inside, inside) + road).clamp(min=1),
        total(cues["learned_road"], seed) / total(seed, seed).clamp(min=1),
        total(entropy(likelihood), free) / total(free, free),
    ]
    return Signs(*(signs if torch.compiler.is_exporting() else map(float, signs)))


def weights_of(area: Tensor) -> Tensor:
    """An area bool (H,W) as weights float32 (H,W); by NumPy, which is five times as fast."""
    if torch.compiler.is_exporting():
        return area.to(torch.float32)
    return torch.from_numpy(area.cpu().numpy().astype(np.float32)).to(area.device)


def total(values: Tensor, weights: Tensor) -> Tensor:
    """The sum of values (H,W) times weights (H,W), as a scalar float64."""
    if torch.compiler.is_exporting():
        return (values * weights).sum((-2, -1))
    return values.reshape(-1).dot(weights.reshape(-1)).double()


def entropy(likelihood: Tensor) -> Tensor:
    """Entropy of likelihoods in [0,1], in bits: 0 where all is clear, 1 at 0.5."""
    other = 1 - likelihood
    tiny = torch.finfo(likelihood.dtype).tiny  # 0 log 0 is 0
    information = likelihood * likelihood.clamp_min(tiny).log2_()
    return information.add_(other * other.clamp_min(tiny).log2_()).neg_()


def judgement(signs: Signs, road: bool | Tensor, settings: TrustSettings) -> Judgement:
    """What signs say of a mask; road: whether there is any in it.

    The reason is the sign that lowers the expectation most, against what it usually is. An exported
    graph gives none, and the trust as a tensor (N,).
    """
    expected: Any = CONSTANT + sum(w * sign for w, sign in zip(WEIGHTS, signs, strict=True))
    odds: Any = ROAD_THERE + ROAD_STEADY * signs.steady + ROAD_VAGUE * signs.vague
    if torch.compiler.is_exporting():
        there = (odds.sigmoid() / ENOUGH).clamp(max=1)
        return Judgement((there * expected.clamp(0, 1)).where(road, 0.0), "")
    if not road:
        return Judgement(0.0, "no road found")
    there = min(1.0, 1 / (1 + math.exp(-odds)) / ENOUGH)
    trust = there * min(1.0, max(0.0, expected))
    if trust >= settings.least:
        return Judgement(trust, "")
    if there < 0.5:
        return Judgement(trust, NO_ROAD)
    losses = [w * (sign - usual) for w, sign, usual in zip(WEIGHTS, signs, USUAL, strict=True)]
    return Judgement(trust, REASONS[losses.index(min(losses))])
