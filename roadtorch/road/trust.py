"""Trust: the predicted F-score of a mask, without its truth. Ours.

A ridge regression of F on ``TrustFeatures``, over labelled images of many cameras and rendered
worlds with a road, times the probability that there is a road at all, a logistic regression on
these and worlds without one. ``python -m train.calibrate trust`` fits and cross-validates both.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.settings import Settings
from roadtorch.base.twins import has_twin
from roadtorch.imaging.levels import is_above


class TrustFeatures(NamedTuple):
    """Features from which the F-score of a mask is predicted, each in [0, 1]."""

    stability: float
    """IoU of the masks at a low and at a high threshold (``LOW_AND_HIGH``)."""
    expected: float
    """F-score of the mask if the likelihood is a calibrated probability."""
    entropy: float
    """Mean entropy of the likelihood, in bits."""


LOW_AND_HIGH = (0.2, 0.8)

FEATURE_WEIGHTS = TrustFeatures(0.05, 0.96, 0.0)  # of the regression; ``INTERCEPT`` is added

INTERCEPT = 0.007

MEAN_FEATURES = TrustFeatures(0.73, 0.91, 0.19)
"""Means of the features over the real images on which the weights were fitted."""

ROAD_STABILITY, ROAD_ENTROPY, ROAD_INTERCEPT = 1.99, -7.49, 2.59
"""Logistic regression of whether there is a road: weights of ``stability`` and ``entropy``."""

FULL_TRUST_PROBABILITY = 0.7
"""Probability that there is a road above which the predicted F is not reduced."""

NO_ROAD = "hardly anything in the image looks like road"

DOUBT_REASONS = (
    "another threshold gives another mask",
    "much of the mask is not likely road",
    "much of the image is neither road nor not",
)
"""Messages for a feature below its mean, in the order of the features."""


class TrustSettings(Settings):
    """Limit below which a mask is called doubtful."""

    threshold: float = Field(
        default=0.6, ge=0, le=1, description="predicted F-score below which a mask is doubtful"
    )


class Judgement(NamedTuple):
    """Predicted F-score of a mask in [0, 1], and in words why it is low; empty if it is not."""

    trust: float
    doubt: str


def trust_features(likelihood: Tensor, mask: Tensor, ego: Tensor) -> TrustFeatures:
    """Compute the features of a likelihood, its mask and the ego car, (H, W), which is left out."""
    free = float_mask(~ego)
    inside = free * float_mask(mask)
    low, high = (
        masked_sum(float_mask(is_above(likelihood, level)), free) for level in LOW_AND_HIGH
    )
    road, right = (masked_sum(likelihood, area) for area in (free, inside))
    return TrustFeatures(
        ratio(high, low),
        ratio(2 * right, masked_sum(inside, inside) + road),
        ratio(masked_sum(entropy(likelihood), free), masked_sum(free, free)),
    )


@has_twin
def ratio(part: Tensor, whole: Tensor) -> float:
    """Divide a scalar by another, or by 1 if that is more."""
    return float(part / whole.clamp(min=1))


@has_twin
def float_mask(area: Tensor) -> Tensor:
    """Convert a bool mask to float32; in NumPy, which is five times as fast."""
    return torch.from_numpy(area.cpu().numpy().astype(np.float32)).to(area.device)


@has_twin
def masked_sum(values: Tensor, mask: Tensor) -> Tensor:
    """Return the sum of values (H, W) over a float mask (H, W), as a float64 scalar."""
    return values.reshape(-1).dot(mask.reshape(-1)).double()


def entropy(likelihood: Tensor) -> Tensor:
    """Compute the entropy of likelihoods in [0, 1], in bits: 0 at 0 and 1, 1 at 0.5."""
    complement = 1 - likelihood
    tiny = torch.finfo(likelihood.dtype).tiny  # 0 log 0 is 0
    information = likelihood * likelihood.clamp_min(tiny).log2_()
    return information.add_(complement * complement.clamp_min(tiny).log2_()).neg_()


def expected_f(features: TrustFeatures) -> float:
    """Predict the F-score of a mask by the linear regression, if there is a road at all."""
    return INTERCEPT + sum(w * x for w, x in zip(FEATURE_WEIGHTS, features, strict=True))


def road_log_odds(features: TrustFeatures) -> float:
    """Predict the log odds that there is a road at all, by the logistic regression."""
    odds = ROAD_INTERCEPT + ROAD_STABILITY * features.stability
    return odds + ROAD_ENTROPY * features.entropy


@has_twin
def estimate_trust(
    features: TrustFeatures, road: bool | Tensor, settings: TrustSettings
) -> Judgement:
    """Predict the F-score of a mask, and name the feature that lowers it most.

    road: whether the mask has a pixel.
    """
    if not road:
        return Judgement(0.0, "no road found")
    presence = min(1.0, 1 / (1 + math.exp(-road_log_odds(features))) / FULL_TRUST_PROBABILITY)
    trust = presence * min(1.0, max(0.0, expected_f(features)))
    if trust >= settings.threshold:
        return Judgement(trust, "")
    if presence < 0.5:
        return Judgement(trust, NO_ROAD)
    terms = zip(FEATURE_WEIGHTS, features, MEAN_FEATURES, strict=True)
    losses = [weight * (value - mean) for weight, value, mean in terms]
    return Judgement(trust, DOUBT_REASONS[losses.index(min(losses))])
