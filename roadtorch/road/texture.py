"""Road texture: colour plane fusion, uniformity of histograms, local binary patterns.

P2: Álvarez et al., "Road Scene Segmentation from a Single Image", sections 4 and 6.2.
"""

from collections.abc import Iterable
from typing import Annotated

import numpy as np
import torch
from pydantic import AfterValidator, Field
from torch import Tensor
from torch.nn import functional

from roadtorch.base.errors import unknown_name_error
from roadtorch.base.settings import Settings
from roadtorch.imaging.color import PLANES, color_planes, iterate_color_planes
from roadtorch.imaging.levels import is_above, is_at_least, order_statistic
from roadtorch.imaging.segments import segment_histogram, segment_size

FLOAT32_ROUNDING = 1e-12
"""Variance, in mean squares of the planes, up to which a direction of Σ varies by rounding alone:
float32 has 1e-14, a level of 8 bits 1e-6; from 1e-12 to 1e-10 the same directions count."""

MIN_RANGE = 1e-4
"""Smallest range that is quantised, as a smaller one holds only rounding errors."""


def minimum_variance_weights(samples: Tensor, ridge: float = 0.0) -> Tensor:
    """Compute the weights (N,), of sum 1, of least variance among combinations of planes that vary.

    w = Σ⁺1 / (1ᵀΣ⁺1), P2 eq. 3 with the pseudo-inverse of the covariance Σ: P2's nine planes are
    linearly dependent (R - G - √2·O1 = 0, R + G - 2B - √6·O2 = 0), so its Σ has no inverse, and a
    combination of sum 1 that is 0 in every image would have the least variance
    (docs/how/layout_texture.md). ``ridge`` times the mean variance is added to the diagonal of Σ,
    which then has an inverse; ours. The weights are equal where no plane varies.

    samples: K pixels of N planes, (K, N). Solved in float64.
    """
    # In NumPy: torch takes twice as long for matrices this small.
    values = samples.cpu().numpy().astype(np.float64)
    centred = values - values.mean(0)
    variances, directions = np.linalg.eigh(centred.T @ centred / max(1, len(samples)))
    variances += ridge * variances.mean()
    is_varying = variances > FLOAT32_ROUNDING * np.square(values).mean()
    directions = directions[:, is_varying]
    weights = directions @ (directions.sum(0) / variances[is_varying])
    weights = weights if is_varying.any() else np.ones(len(weights))
    return torch.from_numpy(weights / weights.sum()).to(samples)


def fused_plane(planes: Iterable[Tensor], weights: Tensor) -> Tensor:
    """Return the sum (H, W) of N planes (H, W) weighted by weights (N,), P2 eq. 2."""
    first, *further = zip(planes, weights.tolist(), strict=True)
    fused = first[0] * first[1]
    for plane, weight in further:
        fused.add_(plane, alpha=weight)
    return fused


def value_range(plane: Tensor, usable: Tensor, tail: float) -> tuple[float, float]:
    """Return the quantiles ``tail`` and 1 - ``tail`` of the usable pixels of a plane (H, W). Ours.

    The fused plane has no natural bounds for its histogram.
    """
    values = plane.reshape(-1) if usable.all() else masked_pixels(plane[None], usable)[0]
    count = len(values)
    if not count:
        return 0.0, 1.0
    skipped = min(int(tail * count), (count - 1) // 2)
    return order_statistic(values, skipped), order_statistic(values, count - 1 - skipped)


def quantise_plane(plane: Tensor, bins: int, low: float, high: float) -> Tensor:
    """Quantise a plane to 0…bins-1, int64, from low to high (``MIN_RANGE`` or more), clamped."""
    scaled = (plane - low) * (bins / max(high - low, MIN_RANGE))
    return scaled.clamp(0, bins - 1).to(torch.int64)


def uniformity(histogram: Tensor) -> Tensor:
    """Compute U = Σ p², P2 eq. 1, of counts (…, L): 1/L if equal, 1 for one bin, 0 if empty."""
    return relative_frequencies(histogram).square().sum(-1)


def saturation_mask(image: Tensor, dark: float, bright: float) -> Tensor:
    """Return the saturated pixels, bool (H, W), of an image (3, H, W): CPFv2, P2 section 6.2.

    The rule is ours, P2 names none: the largest channel is at least ``bright``, so that one is
    clipped, or at most ``dark``, so that there is no colour.
    """
    highest = image.amax(-3)
    return is_at_least(highest, bright) | ~is_above(highest, dark)


def uniformity_likelihood(values: Tensor, midpoint: float) -> Tensor:
    """Turn U into a likelihood in [0, 1): U / (U + m), 0.5 at the midpoint m.

    Ours; P2 thresholds U itself. It is monotone, so ROC curves are unchanged.
    """
    return values / (values + midpoint)


def relative_frequencies(histogram: Tensor) -> Tensor:
    """Divide counts (…, L) by their sum; all 0 for an empty histogram."""
    total = histogram.sum(-1, keepdim=True)
    return histogram / total.clamp_min(torch.finfo(histogram.dtype).tiny)


def _check_plane(name: str) -> str:
    if name not in PLANES:
        raise ValueError(unknown_name_error("plane", name, PLANES))
    return name


class TextureSettings(Settings):
    """Colour plane fusion and the histograms of the fused plane."""

    planes: tuple[Annotated[str, AfterValidator(_check_plane)], ...] = Field(
        default=("R", "G", "B", "nr", "ng", "O1", "O2", "S", "V"),
        min_length=1,
        strict=False,
        description="colour planes that are fused",
    )
    ridge: float = Field(
        default=0.0,
        ge=0,
        le=1e6,
        description="added to each variance, in mean variances; 0 for the pseudo-inverse",
    )
    bins: int = Field(default=64, ge=2, le=4096, description="number of histogram bins")
    tail: float = Field(
        default=0.005, ge=0, lt=0.5, description="fraction of pixels beyond each end of a histogram"
    )
    midpoint: float = Field(
        default=0.35, gt=0, le=1, description="uniformity U whose likelihood is 0.5"
    )


class Saturation(Settings):
    """Pixels that CPFv2 leaves out."""

    dark: float = Field(
        default=0.02, ge=0, le=1, description="saturated if no channel is above this, 0 to 1"
    )
    bright: float = Field(
        default=0.98, ge=0, le=1, description="saturated if a channel is at least this, 0 to 1"
    )
    min_fraction: float = Field(
        default=0.5, ge=0, le=1, description="fraction of unsaturated pixels that a segment needs"
    )


def fused_uniformity(
    image: Tensor, labels: Tensor, usable: Tensor, seed: Tensor, settings: TextureSettings
) -> tuple[Tensor, Tensor]:
    """Fuse the colour planes and compute U of each segment, P2 section 4.

    labels: n segments, int64 (H, W). seed: seed area, bool (H, W), from which the planes' weights
    are computed. usable: pixels that count, bool (H, W); if the seed area has too few, all of it
    counts. Returns the fused plane (H, W) and U (n,).
    """
    samples = masked_pixels(image, seed & usable)
    if samples.shape[1] <= len(settings.planes):
        samples = masked_pixels(image, seed)
    seed_planes = color_planes(samples[..., None], settings.planes)[..., 0]
    weights = minimum_variance_weights(seed_planes.T, settings.ridge)
    fused = fused_plane(iterate_color_planes(image, settings.planes), weights)
    low, high = value_range(fused, usable, settings.tail)
    levels = quantise_plane(fused, settings.bins, low, high)
    count = int(labels.max()) + 1
    return fused, uniformity(segment_histogram(levels, labels, count, settings.bins, usable))


def masked_pixels(image: Tensor, area: Tensor) -> Tensor:
    """Return the K pixels, shape (C, K), of an image (C, H, W) in an area, bool (H, W)."""
    return image.reshape(len(image), -1).index_select(1, area.reshape(-1).nonzero()[:, 0])


def unsaturated_uniformity(
    image: Tensor, labels: Tensor, seed: Tensor, settings: TextureSettings, saturation: Saturation
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute ``fused_uniformity`` without saturated pixels (CPFv2); U = 0 with too few others.

    Returns the fused plane (H, W), U (n,) and the saturated pixels, bool (H, W).
    """
    clipped = saturation_mask(image, saturation.dark, saturation.bright)
    fused, values = fused_uniformity(image, labels, ~clipped, seed, settings)
    size = segment_size(labels, len(values))
    lost = segment_size(labels.reshape(-1)[clipped.reshape(-1).nonzero()[:, 0]], len(values))
    enough = size - lost >= saturation.min_fraction * size
    return fused, values * enough, clipped


# --- local binary patterns ------------------------------------------------------------


CORNER = 0.5**0.5  # row and column of the diagonal neighbours on the circle of radius 1

PATTERN_COUNT = 10


def uniform_patterns(grey: Tensor) -> Tensor:
    """Compute rotation-invariant uniform local binary patterns, int64 (H, W), of an image (H, W).

    LBP^riu2 of Ojala et al., PAMI 2002, 8 neighbours at radius 1; "uniform" in scikit-image.
    0…8: number of neighbours, in one run, at least as bright as the centre; 9: several runs.
    """
    height, width = grey.shape
    padded = functional.pad(grey[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]
    # From the right, anticlockwise; differences to the centre, so that flat areas give exactly 0.
    ring = [(0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1)]
    neighbours = torch.stack(
        [padded[1 + row :, 1 + column :][:height, :width] - grey for row, column in ring]
    )
    straight, diagonal = neighbours[0::2], neighbours[1::2]
    sides = straight + straight.roll(-1, 0)
    between = CORNER * CORNER * diagonal + CORNER * (1 - CORNER) * sides
    bits = torch.stack([straight, between], 1).flatten(0, 1) >= 0
    changes = (bits != bits.roll(1, 0)).sum(0)
    return torch.where(changes <= 2, bits.sum(0), 9)


def similarity(histogram: Tensor, reference: Tensor) -> Tensor:
    """Compute the similarity (…) of histograms (…, L) to one reference (L,) or one each (…, L).

    1 - χ²/2 with χ² = Σ (p-q)²/(p+q): 1 equal, 0 disjoint or where a histogram is empty. The
    log-likelihood of Ojala et al. also rewards regions more even than the reference: its AUC is
    below 0.5 here.
    """
    first, second = relative_frequencies(histogram), relative_frequencies(reference)
    total = first + second
    squares = (first - second).square() / total.clamp_min(torch.finfo(total.dtype).tiny)
    return ((total - squares).sum(-1) / 2).clamp(0, 1)
