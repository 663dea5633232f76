"""Texture of road: colour plane fusion, uniformity of histograms, local binary patterns.

P2: Álvarez et al., "Road Scene Segmentation from a Single Image", sections 4 and 6.2.
"""

import torch
from torch import Tensor
from torch.nn import functional

VARIANCE_FLOOR = 1e-12
"""Added to the diagonal of Σ, so that a constant area has weights too (equal ones)."""

NARROWEST = 1e-4
"""The least range that is cut into levels: below it there is only rounding, planes being of
order 1, and a flat picture would look rough."""

CORNER = 0.5**0.5
"""Row and column of the diagonal neighbours on the circle of radius 1."""

SMALLEST_ROTATION = tuple(
    min((code >> turn | code << (8 - turn)) & 255 for turn in range(8)) for code in range(256)
)
"""For each pattern of eight bits in a circle, the smallest number that a rotation gives."""


def minimum_variance_weights(samples: Tensor, ridge: float) -> Tensor:
    """Weights (N,), summing to 1, whose combination of planes varies least over samples (K,N).

    w = Σ⁻¹1 / (1ᵀΣ⁻¹1), P2 eq. 3. Planes that are linear in one another (O1 and O2 in R, G
    and B) make Σ singular; ``ridge`` ≥ 0 times the mean variance is added to its diagonal:
    0 is P2's formula, large values give the plain mean of the planes. Solved in float64,
    returned in the samples' dtype.
    """
    centred = samples.to(torch.float64)
    centred = centred - centred.mean(0)
    covariance = centred.T @ centred / max(1, len(samples))
    variances = covariance.diagonal()
    load = ridge * variances.mean() + VARIANCE_FLOOR
    covariance = covariance + load * torch.eye(len(variances)).to(covariance)
    weights = torch.linalg.solve(covariance, torch.ones_like(variances))
    return (weights / weights.sum()).to(samples.dtype)


def fused_plane(planes: Tensor, weights: Tensor) -> Tensor:
    """The weighted sum of planes (N,H,W) by weights (N,): (H,W), P2 eq. 2."""
    return torch.einsum("nhw,n->hw", planes, weights)


def value_range(plane: Tensor, usable: Tensor, tail: float) -> tuple[float, float]:
    """The values of a plane (H,W) that leave a share ``tail`` of the usable pixels on each side.

    The range that ``quantise`` cuts into levels. The fused plane has no natural bounds, so
    they come from the picture, as grey levels do from the camera's exposure (ours).
    """
    values = plane[usable]
    count = len(values)
    if not count:
        return 0.0, 1.0
    skipped = min(int(tail * count), (count - 1) // 2)
    low, high = values.kthvalue(skipped + 1), values.kthvalue(count - skipped)
    return float(low.values), float(high.values)


def quantise(plane: Tensor, bins: int, low: float, high: float) -> Tensor:
    """Levels 0…bins-1 (int64) of a plane, equal steps from low to high.

    What lies beyond gets the end levels. A range below ``NARROWEST`` is widened to it.
    """
    scaled = (plane - low) * (bins / max(high - low, NARROWEST))
    return scaled.clamp(0, bins - 1).to(torch.int64)


def uniformity(histogram: Tensor) -> Tensor:
    """U = Σ p², P2 eq. 1, of counts (…,L): (…), from 1/L (even) to 1 (a single level).

    0 for an empty histogram: nothing is known of it, and it must not pass for road.
    """
    return _shares(histogram).square().sum(-1)


def saturated(image: Tensor, dark: float, bright: float) -> Tensor:
    """Where an image (3,H,W) is clipped, bool (H,W): CPFv2, P2 section 6.2.

    The rule is ours, P2 names none: a pixel whose largest channel is at ``bright`` or above
    has lost a channel to the sensor's upper end; one whose largest is at ``dark`` or below
    has no colour left. In both the planes are flat for reasons other than the surface.
    """
    highest = image.amax(-3)
    return (highest >= bright) | (highest <= dark)


def uniformity_likelihood(values: Tensor, even: float) -> Tensor:
    """Turn U into a likelihood in [0,1): U / (U + even), 0.5 at U = ``even``.

    Ours; P2 thresholds U itself. Monotone, so it leaves every ROC curve as it is, and it
    spreads the small values where road and background part.
    """
    return values / (values + even)


def uniform_patterns(grey: Tensor) -> Tensor:
    """Rotation-invariant uniform local binary patterns (8 neighbours, radius 1): int64 (H,W).

    0…8: that many neighbours, in one run, are at least as bright as the centre; 9: several
    runs. LBP^riu2 of Ojala et al., PAMI 2002; "uniform" in scikit-image. The picture is
    continued beyond its edge by its outermost pixels.
    """
    bits = _brighter(grey)
    changes = (bits != bits.roll(1, 0)).sum(0)
    return torch.where(changes <= 2, bits.sum(0), 9)


def smallest_patterns(grey: Tensor) -> Tensor:
    """Rotation-invariant local binary patterns (8 neighbours, radius 1): int64 (H,W), 0…255.

    The smallest number among the rotations of the eight bits, 36 different ones. LBP^ri of
    Ojala et al., PAMI 2002; "ror" in scikit-image. Edges as in ``uniform_patterns``.
    """
    code = torch.zeros_like(grey, dtype=torch.int64)
    for place, bit in enumerate(_brighter(grey)):
        code |= bit.to(torch.int64) << place
    return torch.tensor(SMALLEST_ROTATION, device=grey.device)[code]


def _brighter(grey: Tensor) -> Tensor:
    """Whether each of 8 neighbours on the unit circle is at least as bright: bool (8,H,W).

    From the right, anticlockwise. Differences to the centre are interpolated, not values:
    flat areas then give exactly 0.
    """
    height, width = grey.shape
    padded = functional.pad(grey[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]

    def difference(row: int, column: int) -> Tensor:
        return padded[1 + row : 1 + row + height, 1 + column : 1 + column + width] - grey

    ring = [(0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1)]
    around = torch.stack([difference(*place) for place in ring])
    straight, diagonal = around[0::2], around[1::2]
    sides = straight + straight.roll(-1, 0)
    between = CORNER * CORNER * diagonal + CORNER * (1 - CORNER) * sides
    return torch.stack([straight, between], 1).flatten(0, 1) >= 0


def similarity(histogram: Tensor, reference: Tensor) -> Tensor:
    """How alike counts (…,L) and a reference (L,) are: (…), 1 alike, 0 nothing in common.

    1 - χ²/2 with χ² = Σ (p-q)²/(p+q). Ojala et al. take a log-likelihood, which here also
    rewards regions more even than the reference (AUC below one half); χ², the histogram
    intersection and the Kullback-Leibler divergence came out within 0.01 of one another.
    0 where a histogram is empty.
    """
    one, two = _shares(histogram), _shares(reference)
    total = one + two
    squares = (one - two).square() / total.clamp_min(torch.finfo(total.dtype).tiny)
    return ((total - squares).sum(-1) / 2).clamp(0, 1)


def _shares(histogram: Tensor) -> Tensor:
    total = histogram.sum(-1, keepdim=True)
    return histogram / total.clamp_min(torch.finfo(histogram.dtype).tiny)
