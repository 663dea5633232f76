"""Model-based classifiers: normalised histograms of the samples (P3, section III-B).

With 64 or 100 bins per plane, from the samples (S) or from samples and a noisy copy (S&N).
"""

import math
from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.errors import ConfigError
from roadtorch.oneclass.axes import Axes
from roadtorch.oneclass.base import Classifier, ClassifierSettings, DistanceModel, RoadSamples

MAX_BINS = 1 << 25  # most bins of a joint histogram: 134 MB
EDGE_ROUNDING = 4e-6
"""Fractions of a plane's span by which values count as higher: levels of 8-bit images lie on edges
of bins (R = G in O1), and rounding in float32 must not move them to the bin below. Ours."""

COPY_NOISE = 30 / 256  # standard deviation of the noise, in spans of the plane (P3, section V)


Bins = Annotated[int, Field(ge=2, le=4096, description="bins per plane over its range")]


class HistogramSettings(ClassifierSettings):
    """Model-based classifier: the normalised histogram of the samples."""

    bins: Bins = 64
    planes: Literal["joint", "product"] = Field(
        default="joint",
        description="one joint histogram of all planes, or the product of one for each (suggested "
        "but not used by the paper)",
    )


class NoisyHistogramSettings(HistogramSettings):
    """Histogram of the samples and a noisy copy (S&N)."""

    noise: float = Field(
        default=COPY_NOISE,
        ge=0,
        le=1,
        description="standard deviation of the noise on the copy of the samples, in ranges of the "
        "plane; 0: no copy",
    )


class FineHistogramSettings(HistogramSettings):
    """Histogram of 100 bins."""

    bins: Bins = 100


class FineNoisyHistogramSettings(NoisyHistogramSettings):
    """Histogram of 100 bins of the samples and a noisy copy (S&N)."""

    bins: Bins = 100


def add_noisy_copy(
    samples: Tensor, axes: Axes, deviation: float, generator: torch.Generator
) -> Tensor:
    """Add a copy with Gaussian noise to samples (m, d) (P3, "S&N"): (m', d), m ≤ m' ≤ 2m.

    ``deviation`` is in spans of each axis. Noisy samples wrap on circular axes; beyond the range of
    other axes they are dropped.
    """
    low = torch.tensor(axes.low, dtype=samples.dtype)
    span = axes.span.to(samples.dtype)
    noise = torch.randn(samples.shape, generator=generator, dtype=samples.dtype)
    noisy = samples + noise * (deviation * span)
    wraps = torch.tensor(axes.circular)
    noisy = torch.where(wraps, (noisy - low).remainder(span) + low, noisy)
    return torch.cat([samples, noisy[((noisy >= low) & (noisy <= low + span)).all(1)]])


def bin_indices(planes: Tensor, low: Tensor, scale: Tensor, bins: int) -> Tensor:
    """Return the bins of planes (d, n), int32 in 0…bins-1; ``scale`` (d,) is bins per unit.

    A value on the edge of two bins is in the upper one (``EDGE_ROUNDING``).
    """
    positions = (planes - low[:, None]).mul_(scale[:, None]).add_(EDGE_ROUNDING * bins)
    return positions.clamp_(0, bins - 1).to(torch.int32)


def fit_histogram(road: RoadSamples, settings: HistogramSettings) -> DistanceModel:
    """Fit √(2 ln(peak/p)), p the fraction of samples in the pixel's bin: L = p(x) in P3.

    The histogram is joint, or one for each plane; empty bins are infinitely far.
    """
    samples, axes, bins = road.samples, road.axes, settings.bins
    dimensions, joint = len(axes), settings.planes == "joint"
    if isinstance(settings, NoisyHistogramSettings) and settings.noise > 0:
        samples = add_noisy_copy(samples, axes, settings.noise, road.generator)
    if joint and bins**dimensions > MAX_BINS:
        problem = f"{bins} bins in {dimensions} dimensions are too many"
        raise ConfigError("bins", problem, 'use fewer, or planes="product"')
    low, scale = torch.tensor(axes.low), (bins / axes.span).float()

    def indices(planes: Tensor) -> list[Tensor]:  # of each histogram int64 (n,)
        numbers = bin_indices(planes, low, scale, bins)
        if not joint:
            return [row.long() for row in numbers]
        index = numbers[0].long()
        for row in numbers[1:]:
            index = index.mul_(bins).add_(row)
        return [index]

    tables = []
    for index in indices(samples.T.float()):
        table = torch.full((bins ** (dimensions if joint else 1),), math.inf)
        filled, counts = index.unique(return_counts=True)
        table[filled] = (2 * (counts.max() / counts).double().log()).float()
        tables.append(table)

    def distance(pixels: Tensor) -> Tensor:
        squares = [table[index] for table, index in zip(tables, indices(pixels), strict=True)]
        return (squares[0] if joint else torch.stack(squares).sum(0)).sqrt_()

    return DistanceModel(distance, 4 * dimensions + 4)


HISTOGRAMS = tuple(
    Classifier(name, summary, settings, fit_histogram)
    for name, summary, settings in (
        ("hist64_s", "histogram of 64 bins", HistogramSettings),
        ("hist64_sn", "histogram of 64 bins, with noise", NoisyHistogramSettings),
        ("hist100_s", "histogram of 100 bins", FineHistogramSettings),
        ("hist100_sn", "histogram of 100 bins, with noise", FineNoisyHistogramSettings),
    )
)
"""Model-based classifiers of P3."""
