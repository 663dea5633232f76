"""Appearance: a road classifier learned in each image from the network's own prediction. Ours.

P2 fuses what was learned off line with what the image shows on line; P3 learns a classifier from
the image's own road. Here both use features that know more than colour: a linear discriminant
between the pixels that the network takes for road and for background, on the finest map of its
backbone and six colour planes, gives a second opinion, which is averaged with the network's.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

RELATIVE_RIDGE = 0.3
"""Fraction of the mean variance added to each variance, against overfitting of 30 features."""

MIN_PIXELS = 20.0
"""Weighted pixels of each class below which an image shows too little to learn from."""

MAX_WEIGHT = 0.5
"""Largest weight of the appearance: the network keeps at least half, however unsure it is."""

SCHULZ_STEPS = 14
"""Iterations of the inverse: enough for a condition number of 1,000."""

DARK_LEVEL = 0.02
"""Added to channels before their logarithm: sensor noise in the dark is not colour."""


def appearance_planes(image: Tensor) -> Tensor:
    """Compute r, g, b chromaticity, brightness, saturation and log R/B: (…, 6, H, W).

    image: sRGB in [0, 1], shape (…, 3, H, W).
    """
    red, _, blue = image.unbind(-3)
    total = image.sum(-3) + 1e-3
    saturation = image.amax(-3) - image.amin(-3)
    ratio = (red + DARK_LEVEL).log() - (blue + DARK_LEVEL).log()
    chromaticity = image / total.unsqueeze(-3)
    return torch.cat([chromaticity, torch.stack([total / 3, saturation, ratio], -3)], -3)


def appearance_log_odds(features: Tensor, log_odds: Tensor) -> Tensor:
    """Compute the log odds of road by appearance, with a discriminant learned in this image.

    Fisher's linear discriminant d = S⁻¹ (m₁ - m₀) between pixels weighted by how surely the
    network takes them for road, max(0, 2p - 1), and for background, max(0, 1 - 2p). m are the
    weighted means, S is the mean of both weighted covariances plus a ridge. The scores get the
    standard deviation of the network's log odds, so that both can be averaged.

    Args:
        features: any features of the pixels, shape (…, C, N).
        log_odds: the network's log odds of road, shape (…, N).

    Returns:
        Log odds, shape (…, N); the network's own where road or background is missing.
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
    direction = invert(add_ridge(scatter)) @ (road - background).unsqueeze(-1)
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
    """Add ``RELATIVE_RIDGE`` times the mean variance to the diagonal of covariances (…, C, C)."""
    identity = torch.eye(scatter.shape[-1]).to(scatter)
    mean = (scatter * identity).sum((-2, -1), keepdim=True) / scatter.shape[-1]
    return scatter + RELATIVE_RIDGE * mean * identity


def invert(matrix: Tensor) -> Tensor:
    """Invert symmetric positive definite matrices (…, C, C) by matrix products.

    Schulz's iteration X ← X (2 I - A X), Z. Angew. Math. Mech. 13, 1933, doubles the correct
    digits in each step. ONNX has no operator that solves equations.
    """
    identity = torch.eye(matrix.shape[-1]).to(matrix)
    inverse = identity / matrix.abs().sum(-1).amax(-1)[..., None, None].clamp_min(1e-12)
    for _ in range(SCHULZ_STEPS):
        inverse = inverse @ (2 * identity - matrix @ inverse)
    return inverse


def average_log_odds(log_odds: Tensor, appearance: Tensor, weight: float) -> Tensor:
    """Average the log odds (…, N) of network and appearance, by the network's doubt in this image.

    log odds = (1 - α) network + α appearance, with α = weight · (1 - mean |2p - 1|), at most
    ``MAX_WEIGHT``: the more unlike its training images a camera is, the more the image decides.
    """
    doubt = 1 - (2 * log_odds.sigmoid() - 1).abs().mean(-1, keepdim=True)
    return torch.lerp(log_odds, appearance, (weight * doubt).clamp_max(MAX_WEIGHT))


def fuse_appearance(scores: Tensor, features: Tensor, images: Tensor, weight: float) -> Tensor:
    """Fuse the network's log odds of road with the appearance learned in each image.

    Args:
        scores: log odds of road by the network, shape (B, h, w).
        features: the finest features of the network, shape (B, C, h, w).
        images: sRGB in [0, 1], shape (B, 3, H, W); H and W are multiples of h and w.
        weight: weight of the appearance per mean doubt; see ``average_log_odds``.

    Returns:
        Log odds by both and by appearance alone, shape (B, 2, h, w).
    """
    step = images.shape[-2] // scores.shape[-2]
    planes = appearance_planes(F.avg_pool2d(images, step))
    log_odds = scores.flatten(1)
    appearance = appearance_log_odds(torch.cat([features, planes], 1).flatten(2), log_odds)
    fused = average_log_odds(log_odds, appearance, weight)
    return torch.stack([fused, appearance], 1).unflatten(-1, scores.shape[-2:])
