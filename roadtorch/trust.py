"""How far a mask can be trusted: the F it is expected to have, from what the detector knows. Ours.

A good mask has a sharp border in likelihood, is road throughout to the network as well, and
begins at a seed area that is. The weights are a ridge regression of F on these signs over
labelled pictures of many cameras (``train/choose_many.py trust``, which tells what they are
worth on a camera that had no part).
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.settings import Settings


class Signs(NamedTuple):
    """What tells a good mask from a bad one."""

    undecided: float
    """Pixels that are neither road nor not (``UNSURE``) per pixel of the mask, to ``MOST``."""
    patchy: float
    """Twice the deviation of the network's road inside the mask, from 0 to 1."""
    unclear: float
    """Mean entropy of the ground's potential, in bits."""
    seed: float
    """Mean of the network's road in the seed area, from 0 to 1."""


UNSURE = (0.1, 0.9)
MOST = 5.0

WEIGHTS = Signs(-0.17, -0.31, -0.3, 0.34)
"""Of the signs; ``CONSTANT`` is added."""

CONSTANT = 0.753

USUAL = Signs(0.45, 0.3, 0.19, 0.95)
"""The mean signs over the pictures on which the weights were chosen."""

REASONS = (
    "much around the mask is neither road nor not",
    "part of the mask does not look like road",
    "ground and what stands on it are hard to tell apart",
    "the seed area looks like a vehicle, a wall or grass",
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


def signs_of(likelihood: Tensor, mask: Tensor, found: Mapping[str, Tensor]) -> Signs:
    """The signs of a mask bool (H,W) made of a likelihood (H,W) in [0,1].

    found: the cues ``learned_road`` (H,W), ``layout`` (3,H,W), its last class the ground,
    ``seed_area`` and ``ego``.
    """
    free, learned, seed = ~found["ego"], found["learned_road"], found["seed_area"]
    inside = mask & free
    between = (likelihood > UNSURE[0]) & (likelihood < UNSURE[1]) & free
    values = (
        (between.sum() / inside.sum().clamp_min(1)).clamp_max(MOST),
        learned[inside].std(correction=0) * 2 if inside.any() else torch.ones(()),
        entropy(found["layout"][-1].clamp(0, 1)).mean(),
        learned[seed].mean() if seed.any() else torch.zeros(()),
    )
    return Signs(*(float(value) for value in values))


def entropy(likelihood: Tensor) -> Tensor:
    """Entropy of likelihoods in [0,1], in bits: 0 where all is clear, 1 at 0.5."""
    return torch.special.entr(torch.stack([likelihood, 1 - likelihood])).sum(0) / math.log(2)


def judgement(signs: Signs, road: bool, settings: TrustSettings) -> Judgement:
    """What signs say of a mask; road: whether there is any in it.

    The reason is the sign that lowers the expectation most, against what it usually is.
    """
    if not road:
        return Judgement(0.0, "no road found")
    expected = CONSTANT + sum(w * sign for w, sign in zip(WEIGHTS, signs, strict=True))
    trust = min(1.0, max(0.0, expected))
    if trust >= settings.least:
        return Judgement(trust, "")
    losses = [w * (sign - usual) for w, sign, usual in zip(WEIGHTS, signs, USUAL, strict=True)]
    return Judgement(trust, REASONS[losses.index(min(losses))])
