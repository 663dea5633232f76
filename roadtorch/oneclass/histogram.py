"""The model-based classifiers: normalised histograms of the samples (P3, section III-B).

With 64 or 100 bins per plane, from the samples (S) or from samples and a noisy copy (S&N).
"""

import math
from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.errors import ConfigError
from roadtorch.oneclass.axes import Axes
from roadtorch.oneclass.base import Classifier, ClassifierSettings, Learned, Road

MAX_BINS = 1 << 25
"""Of a joint histogram: 134 MB."""

NOISE = 30 / 256
"""P3, section V: standard deviation of the noise, in spans of the plane."""


Bins = Annotated[int, Field(ge=2, le=4096, description="bins per plane over its whole range")]


class HistogramSettings(ClassifierSettings):
    """Model-based classifier: the normalised histogram of the samples."""

    bins: Bins = 64
    planes: Literal["joint", "product"] = Field(
        default="joint",
        description="one histogram over all planes, or the product of one for each (which the "
        "paper suggests but did not do)",
    )


class NoisyHistogramSettings(HistogramSettings):
    """The same from the samples and a noisy copy (S&N)."""

    noise: float = Field(
        default=NOISE,
        ge=0,
        le=1,
        description="standard deviation of the noise on a second copy of the samples, in ranges "
        "of the plane; 0: the samples alone, which have the same histogram as two copies",
    )
    edge: Literal["drop", "clip"] = Field(
        default="drop", description="what becomes of noisy samples beyond the plane's range"
    )


class FineHistogramSettings(HistogramSettings):
    """The same with 100 bins."""

    bins: Bins = 100


class FineNoisyHistogramSettings(NoisyHistogramSettings):
    """The same with 100 bins from the samples and a noisy copy (S&N)."""

    bins: Bins = 100


def with_noisy_copy(
    samples: Tensor,
    axes: Axes,
    deviation: float,
    edge: Literal["drop", "clip"],
    generator: torch.Generator,
) -> Tensor:
    """Samples (m,d) and a copy with Gaussian noise (P3, "S&N"): (m',d), m ≤ m' ≤ 2m.

    deviation: in spans of each axis. Circular axes wrap; elsewhere noisy samples that leave
    the range are dropped or clipped.
    """
    low = torch.tensor(axes.low, dtype=samples.dtype)
    span = axes.span.to(samples.dtype)
    noise = torch.randn(samples.shape, generator=generator, dtype=samples.dtype)
    noisy = samples + noise * (deviation * span)
    wraps = torch.tensor(axes.circular)
    noisy = torch.where(wraps, (noisy - low).remainder(span) + low, noisy)
    if edge == "drop":
        noisy = noisy[((noisy >= low) & (noisy <= low + span)).all(1)]
    return torch.cat([samples, noisy])


def bin_of(planes: Tensor, low: Tensor, scale: Tensor, bins: int) -> Tensor:
    """The bin of each value of planes (d,n): int32 (d,n) in 0…bins-1, outside clamped.

    scale: bins per unit, (d,).
    """
    places = (planes - low[:, None]).mul_(scale[:, None])
    return places.clamp_(0, bins - 1).to(torch.int32)


def fit_histogram(road: Road, settings: HistogramSettings) -> Learned:
    """√(2 ln(peak/p)) with p the histogram's share of the pixel's bin: L = p(x) in P3.

    The histogram of the samples, joint or one for each plane; infinite in empty bins.
    """
    samples, axes, bins = road.samples, road.axes, settings.bins
    dimensions, joint = len(axes), settings.planes == "joint"
    if isinstance(settings, NoisyHistogramSettings) and settings.noise > 0:
        samples = with_noisy_copy(samples, axes, settings.noise, settings.edge, road.generator)
    if joint and bins**dimensions > MAX_BINS:
        problem = f"{bins} bins in {dimensions} dimensions are too many"
        raise ConfigError("bins", problem, 'use fewer, or planes="product"')
    low, scale = torch.tensor(axes.low), (bins / axes.span).float()

    def places(planes: Tensor) -> list[Tensor]:
        """For each histogram the bins int64 (n,) of planes (d,n), the first plane slowest."""
        numbers = bin_of(planes, low, scale, bins)
        if not joint:
            return [row.long() for row in numbers]
        index = numbers[0].long()
        for row in numbers[1:]:
            index = index.mul_(bins).add_(row)
        return [index]

    tables = []
    for index in places(samples.T.float()):
        table = torch.full((bins ** (dimensions if joint else 1),), math.inf)
        filled, counts = index.unique(return_counts=True)
        table[filled] = (2 * (counts.max() / counts).double().log()).float()
        tables.append(table)

    def distance(pixels: Tensor) -> Tensor:
        squares = [table[index] for table, index in zip(tables, places(pixels), strict=True)]
        return (squares[0] if joint else torch.stack(squares).sum(0)).sqrt_()

    return Learned(distance, 4 * dimensions + 4)


CLASSIFIERS = tuple(
    Classifier(name, summary, settings, fit_histogram)
    for name, summary, settings in (
        ("hist64_s", "histogram of 64 bins", HistogramSettings),
        ("hist64_sn", "histogram of 64 bins, with noise", NoisyHistogramSettings),
        ("hist100_s", "histogram of 100 bins", FineHistogramSettings),
        ("hist100_sn", "histogram of 100 bins, with noise", FineNoisyHistogramSettings),
    )
)
"""The four model-based classifiers of P3."""
