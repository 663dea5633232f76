"""How sure figures are: images drawn anew inside their groups, detectors compared in pairs.

Pixels of one image are not independent, images of one drive less than they look; so whole
images are drawn, inside each group, as often as the group has images. All figures of all
detectors over the same images use the same draws: what an easy or a hard draw does to both
of two detectors cancels in their difference.

Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 13 (percentiles).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

REPLICATES = 1000
Figure = Callable[[list[Tensor]], Tensor]
"""One weight tensor int64 (replicates,images) per group → the figure, float64 (replicates,)."""


class Interval(NamedTuple):
    """Both ends of a 95 % interval; NaN where no draw has a value."""

    low: float = math.nan
    high: float = math.nan

    @property
    def is_known(self) -> bool:
        """Whether it has two ends."""
        return not math.isnan(self.low) and not math.isnan(self.high)


@dataclass(frozen=True)
class Replicated:
    """A figure of all images, and its values under every draw, float64 (replicates,)."""

    value: float
    draws: Tensor


def bootstrap_weights(images: int, replicates: int, generator: torch.Generator) -> Tensor:
    """How often each image is drawn, int64 (replicates,images): each row sums to ``images``."""
    drawn = torch.randint(images, (replicates, images), generator=generator)
    ones = torch.ones_like(drawn)
    return torch.zeros_like(drawn).scatter_add_(1, drawn, ones)


def group_weights(
    group_sizes: Sequence[int], generator: torch.Generator, replicates: int = REPLICATES
) -> list[Tensor]:
    """One draw of every group's images for all figures: int64 (replicates,images) each."""
    return [bootstrap_weights(size, replicates, generator) for size in group_sizes]


def replicate(figure: Figure, weights: Sequence[Tensor]) -> Replicated:
    """A figure over all images and over every draw of ``weights`` (of `group_weights`)."""
    once = [torch.ones_like(part[:1]) for part in weights]
    return Replicated(float(figure(once)), figure(list(weights)))


def interval(figure: Replicated) -> Interval:
    """The 95 % percentile interval of a figure; draws without a value are left out."""
    values = figure.draws[~figure.draws.isnan()]
    if not len(values):
        return Interval()
    low, high = torch.quantile(values, torch.tensor([0.025, 0.975], dtype=values.dtype))
    return Interval(float(low), float(high))


def difference(one: Replicated, other: Replicated) -> Replicated:
    """How much larger ``one`` is than ``other``, draw by draw; both of the same weights.

    Its `interval` lies above 0 where ``one`` is larger beyond what the choice of images
    explains. Raises ValueError when the numbers of draws differ.
    """
    if one.draws.shape != other.draws.shape:
        raise ValueError(
            f"{len(one.draws)} draws cannot be compared with {len(other.draws)}: "
            "replicate both with the same weights"
        )
    return Replicated(one.value - other.value, one.draws - other.draws)
