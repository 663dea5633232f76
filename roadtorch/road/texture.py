"""Texture of road: colour plane fusion and the uniformity of histograms.

P2: Álvarez et al., "Road Scene Segmentation from a Single Image", sections 4 and 6.2.
"""

from collections.abc import Iterable
from typing import Annotated

import numpy as np
import torch
from pydantic import AfterValidator, Field
from torch import Tensor
from torch.nn import functional

from roadtorch.base.errors import unknown_name
from roadtorch.base.settings import Settings
from roadtorch.imaging.color import PLANES, each_plane, planes
from roadtorch.imaging.levels import above, at_least, order_statistic
from roadtorch.imaging.segments import segment_histogram, segment_size

VARIANCE_FLOOR = 1e-12
"""Added to the diagonal of Σ, so that a constant area has weights too (equal ones)."""

NARROWEST = 1e-4
"""The least range that is cut into levels: below it there is only rounding, planes being of
order 1, and a flat image would look rough."""


def minimum_variance_weights(samples: Tensor, ridge: float) -> Tensor:
    """Weights (N,), summing to 1, whose combination of planes varies least over samples (K,N).

    w = Σ⁻¹1 / (1ᵀΣ⁻¹1), P2 eq. 3. P2's nine planes are linear in one another (R - G - √2·O1 = 0,
    R + G - 2B - √6·O2 = 0), so its Σ has no inverse, and (R - G - √2·O1) / -√2, whose weights sum
    to 1, is 0 in every image: the least variance that there is, and no texture. So ``ridge`` ≥ 0
    times the mean variance is added to the diagonal. 0 leaves ``VARIANCE_FLOOR`` alone, which is
    P2's formula as far as numbers go, and collapses (docs/research/p2.md); large values give the
    plain mean of the planes. Solved in float64, returned in the samples' dtype.
    """
    # In NumPy: with matrices as small as these torch takes twice as long.
    centred = samples.cpu().numpy().astype(np.float64)
    centred -= centred.mean(0)
    covariance = centred.T @ centred / max(1, len(samples))
    load = ridge * covariance.trace() / len(covariance) + VARIANCE_FLOOR
    np.fill_diagonal(covariance, covariance.diagonal() + load)
    weights = np.linalg.solve(covariance, np.ones(len(covariance)))
    return torch.from_numpy(weights / weights.sum()).to(samples)


def fused_plane(planes: Iterable[Tensor], weights: Tensor) -> Tensor:
    """The weighted sum of N planes (H,W) by weights (N,): (H,W), P2 eq. 2."""
    first, *further = zip(planes, weights.tolist(), strict=True)
    fused = first[0] * first[1]
    for plane, weight in further:
        fused.add_(plane, alpha=weight)
    return fused


def value_range(plane: Tensor, usable: Tensor, tail: float) -> tuple[float, float]:
    """The values of a plane (H,W) that leave a share ``tail`` of the usable pixels on each side.

    The range that ``quantise`` cuts into levels. The fused plane has no natural bounds, so
    they come from the image, as grey levels do from the camera's exposure (ours).
    """
    values = plane.reshape(-1) if usable.all() else samples_of(plane[None], usable)[0]
    count = len(values)
    if not count:
        return 0.0, 1.0
    skipped = min(int(tail * count), (count - 1) // 2)
    return order_statistic(values, skipped), order_statistic(values, count - 1 - skipped)


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
    return shares(histogram).square().sum(-1)


def saturated(image: Tensor, dark: float, bright: float) -> Tensor:
    """Where an image (3,H,W) is clipped, bool (H,W): CPFv2, P2 section 6.2.

    The rule is ours, P2 names none: a pixel whose largest channel is at ``bright`` or above
    has lost a channel to the sensor's upper end; one whose largest is at ``dark`` or below
    has no colour left. In both the planes are flat for reasons other than the surface.
    """
    highest = image.amax(-3)
    return at_least(highest, bright) | ~above(highest, dark)


def uniformity_likelihood(values: Tensor, even: float) -> Tensor:
    """Turn U into a likelihood in [0,1): U / (U + even), 0.5 at U = ``even``.

    Ours; P2 thresholds U itself. Monotone, so it leaves every ROC curve as it is, and it
    spreads the small values where road and background part.
    """
    return values / (values + even)


def shares(histogram: Tensor) -> Tensor:
    """Counts (…,L) as shares of their sum: (…,L), all 0 for an empty histogram."""
    total = histogram.sum(-1, keepdim=True)
    return histogram / total.clamp_min(torch.finfo(histogram.dtype).tiny)


def _known_plane(name: str) -> str:
    if name not in PLANES:
        raise ValueError(unknown_name("plane", name, PLANES))
    return name


class TextureSettings(Settings):
    """Colour plane fusion and the histograms of the fused plane."""

    planes: tuple[Annotated[str, AfterValidator(_known_plane)], ...] = Field(
        default=("R", "G", "B", "nr", "ng", "O1", "O2", "S", "V"),
        min_length=1,
        strict=False,
        description="the colour planes that are fused",
    )
    ridge: float = Field(
        default=3e-3, ge=0, le=1e6, description="share of the mean variance added to the diagonal"
    )
    bins: int = Field(default=64, ge=2, le=4096, description="levels of the histograms")
    tail: float = Field(
        default=0.005, ge=0, lt=0.5, description="share of pixels beyond the levels, on each side"
    )
    even: float = Field(
        default=0.35, gt=0, le=1, description="the uniformity U whose likelihood is 0.5"
    )


class Saturation(Settings):
    """Which pixels CPFv2 leaves out."""

    dark: float = Field(
        default=0.02, ge=0, le=1, description="saturated if no channel is above this (0 to 1)"
    )
    bright: float = Field(
        default=0.98, ge=0, le=1, description="saturated if a channel reaches this (0 to 1)"
    )
    least: float = Field(
        default=0.5, ge=0, le=1, description="share of unsaturated pixels a segment needs"
    )


def fused_uniformity(
    image: Tensor, labels: Tensor, usable: Tensor, seed: Tensor, settings: TextureSettings
) -> tuple[Tensor, Tensor]:
    """P2 section 4 step by step: weights from the seed area, fused plane, U of each segment.

    image: (3,H,W); labels: int64 (H,W), n segments; seed: bool (H,W), the seed area; usable:
    bool (H,W), the pixels that count, for the weights as for the histograms (where the seed
    area has too few, all of its pixels give the weights). Returns the fused plane (H,W) and U (n,).
    """
    samples = samples_of(image, seed & usable)
    if samples.shape[1] <= len(settings.planes):
        samples = samples_of(image, seed)
    of_planes = planes(samples[..., None], settings.planes)[..., 0]
    weights = minimum_variance_weights(of_planes.T, settings.ridge)
    fused = fused_plane(each_plane(image, settings.planes), weights)
    low, high = value_range(fused, usable, settings.tail)
    levels = quantise(fused, settings.bins, low, high)
    count = int(labels.max()) + 1
    return fused, uniformity(segment_histogram(levels, labels, count, settings.bins, usable))


def samples_of(image: Tensor, area: Tensor) -> Tensor:
    """The pixels (C,K) of an image (C,H,W) in an area bool (H,W)."""
    return image.reshape(len(image), -1).index_select(1, area.reshape(-1).nonzero()[:, 0])


def unsaturated_uniformity(
    image: Tensor, labels: Tensor, seed: Tensor, settings: TextureSettings, saturation: Saturation
) -> tuple[Tensor, Tensor, Tensor]:
    """CPFv2: the same without saturated pixels; U = 0 where a segment has few others.

    Returns the fused plane (H,W), U (n,) and where the image is saturated, bool (H,W).
    """
    clipped = saturated(image, saturation.dark, saturation.bright)
    fused, values = fused_uniformity(image, labels, ~clipped, seed, settings)
    size = segment_size(labels, len(values))
    lost = segment_size(labels.reshape(-1)[clipped.reshape(-1).nonzero()[:, 0]], len(values))
    kept = size - lost >= saturation.least * size
    return fused, values * kept, clipped


# --- local binary patterns ------------------------------------------------------------


CORNER = 0.5**0.5  # row and column of the diagonal neighbours on the circle of radius 1

PATTERNS = 10  # different ones


def uniform_patterns(grey: Tensor) -> Tensor:
    """Rotation-invariant uniform local binary patterns (8 neighbours, radius 1): int64 (H,W).

    0…8: that many neighbours, in one run, are at least as bright as the centre; 9: several
    runs. LBP^riu2 of Ojala et al., PAMI 2002; "uniform" in scikit-image. The image is
    continued beyond its edge by its outermost pixels.
    """
    height, width = grey.shape
    padded = functional.pad(grey[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]
    # From the right, anticlockwise; differences to the centre, so that flat areas give exactly 0.
    ring = [(0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1)]
    around = torch.stack(
        [padded[1 + row :, 1 + column :][:height, :width] - grey for row, column in ring]
    )
    straight, diagonal = around[0::2], around[1::2]
    sides = straight + straight.roll(-1, 0)
    between = CORNER * CORNER * diagonal + CORNER * (1 - CORNER) * sides
    bits = torch.stack([straight, between], 1).flatten(0, 1) >= 0
    changes = (bits != bits.roll(1, 0)).sum(0)
    return torch.where(changes <= 2, bits.sum(0), 9)


def similarity(histogram: Tensor, reference: Tensor) -> Tensor:
    """How alike counts (…,L) and a reference (L,) are: (…), 1 alike, 0 nothing in common.

    1 - χ²/2 with χ² = Σ (p-q)²/(p+q). Ojala et al. take a log-likelihood, which here also
    rewards regions more even than the reference (AUC below one half); χ², the histogram
    intersection and the Kullback-Leibler divergence came out within 0.01 of one another.
    0 where a histogram is empty.
    """
    first, second = shares(histogram), shares(reference)
    total = first + second
    squares = (first - second).square() / total.clamp_min(torch.finfo(total.dtype).tiny)
    return ((total - squares).sum(-1) / 2).clamp(0, 1)
