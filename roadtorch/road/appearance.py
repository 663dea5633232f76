"""Appearance: a road classifier learned in each image from the network's own prediction. Ours.

As in P3 a classifier is learned in the image, and as in P2 it is fused with one learned off line:
a linear discriminant between the pixels that the network predicts as road and as background, on the
finest features of its backbone and six colour planes. Its log odds are averaged with the network's.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.twins import has_twin

RELATIVE_RIDGE = 0.3
"""Multiple of the mean variance added to each variance, against overfitting of 30 features."""

MIN_PIXELS = 20.0
"""Sum of a class's pixel weights below which nothing is learned."""

MAX_WEIGHT = 0.5
"""Largest weight of the appearance against the network."""

DARK_LEVEL = 0.02
"""Added to channels before their logarithm, so that sensor noise in the dark is not colour."""


def appearance_planes(image: Tensor) -> Tensor:
    """Compute r, g, b, brightness, max - min and log R/B, (…, 6, H, W), of images (…, 3, H, W)."""
    red, _, blue = image.unbind(-3)
    total = image.sum(-3) + 1e-3
    saturation = image.amax(-3) - image.amin(-3)
    ratio = (red + DARK_LEVEL).log() - (blue + DARK_LEVEL).log()
    chromaticity = image / total.unsqueeze(-3)
    return torch.cat([chromaticity, torch.stack([total / 3, saturation, ratio], -3)], -3)


def appearance_log_odds(features: Tensor, log_odds: Tensor) -> Tensor:
    """Compute the log odds of road by appearance, with a discriminant learned in this image.

    Fisher's linear discriminant d = S⁻¹ (m₁ - m₀) between road, pixels weighted by max(0, 2p - 1),
    and background, max(0, 1 - 2p), with the network's probability p. m are the weighted means, S is
    the mean of both weighted covariances plus a ridge. The scores are scaled to the standard
    deviation of the network's log odds, so that both can be averaged.

    features: of pixels, (…, C, N). log_odds: the network's, (…, N). Returns log odds (…, N); the
    network's unchanged where an image has less than ``MIN_PIXELS`` of road or background.
    """
    features = standardise(features)
    belief = 2 * log_odds.sigmoid() - 1
    weights = torch.stack([belief, -belief], -2).clamp_min(0)
    totals = weights.sum(-1, keepdim=True)
    weights = weights / totals.clamp_min(1)
    means = weights @ features.mT
    weighted = features * weights.sum(-2, keepdim=True)
    scatter = (weighted @ features.mT - means.mT @ means) / 2
    road, background = means.unbind(-2)
    direction = solve(add_ridge(scatter), (road - background).unsqueeze(-1))
    middle = (direction.squeeze(-1) * (road + background)).sum(-1, keepdim=True) / 2
    scores = (direction.mT @ features).squeeze(-2) - middle
    spread = log_odds.std(-1, keepdim=True) / (scores.std(-1, keepdim=True) + 1e-6)
    is_enough = (totals >= MIN_PIXELS).all(-2)
    return torch.where(is_enough, scores * spread, log_odds)


def standardise(features: Tensor) -> Tensor:
    """Shift and scale each feature of (…, C, N) to mean 0 and standard deviation 1."""
    centred = features - features.mean(-1, keepdim=True)
    return centred / (centred.square().mean(-1, keepdim=True).sqrt() + 1e-6)


def add_ridge(scatter: Tensor) -> Tensor:
    """Add ``RELATIVE_RIDGE`` times the mean variance to the diagonal of covariances (…, C, C).

    A little more, so that those of a flat image can be inverted.
    """
    identity = torch.eye(scatter.shape[-1]).to(scatter)
    mean = (scatter * identity).sum((-2, -1), keepdim=True) / scatter.shape[-1]
    return scatter + (RELATIVE_RIDGE * mean + 1e-12) * identity


@has_twin
def solve(matrix: Tensor, vector: Tensor) -> Tensor:
    """Solve A x = v, (…, C, 1), for symmetric positive definite matrices A (…, C, C)."""
    return torch.linalg.solve(matrix, vector)


def average_log_odds(log_odds: Tensor, appearance: Tensor, weight: float) -> Tensor:
    """Average the log odds (…, N) of network and appearance, by the network's doubt in this image.

    (1 - α) network + α appearance, with α = weight · (1 - mean |2p - 1|), at most ``MAX_WEIGHT``.
    """
    doubt = 1 - (2 * log_odds.sigmoid() - 1).abs().mean(-1, keepdim=True)
    return torch.lerp(log_odds, appearance, (weight * doubt).clamp_max(MAX_WEIGHT))


def fuse_appearance(scores: Tensor, features: Tensor, images: Tensor, weight: float) -> Tensor:
    """Fuse the network's log odds of road (B, h, w) with the appearance learned in each image.

    features: (B, C, h, w). images: (B, 3, H, W) in [0, 1], H and W multiples of h and w. weight: as
    in ``average_log_odds``. Returns the fused log odds and the appearance's, (B, 2, h, w).
    """
    step = images.shape[-2] // scores.shape[-2]
    planes = appearance_planes(F.avg_pool2d(images, step))
    log_odds = scores.flatten(1)
    appearance = appearance_log_odds(torch.cat([features, planes], 1).flatten(2), log_odds)
    fused = average_log_odds(log_odds, appearance, weight)
    return torch.stack([fused, appearance], 1).unflatten(-1, scores.shape[-2:])
