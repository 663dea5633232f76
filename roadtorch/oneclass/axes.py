"""What the columns of samples and pixels are, and hue as a circle.

P3 mentions circular distances as a possibility and does not say what it did. Here hue
becomes an ordinary number before any classifier sees it, so that all of them can have it as a
circle.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import torch
from torch import Tensor

from roadtorch.base.errors import unknown_name
from roadtorch.imaging.color import PLANES

Hue = Literal["unrolled", "linear"]
"""``unrolled``: distance along the circle from the mean hue of the samples, exact for
everything within half a turn of it. ``linear``: the number as it is, cut at red, which is
what P3's column H suggests."""

MIN_MEAN_LENGTH = 1e-6
"""Below this length of their mean vector hues have no mean, and 0 is taken."""


@dataclass(frozen=True)
class Axes:
    """What the columns of samples and pixels are.

    names: one for each. low, high: their bounds. circular: whether high is the same as low.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    circular: tuple[bool, ...]

    def __len__(self) -> int:
        """How many there are."""
        return len(self.names)

    @cached_property
    def span(self) -> Tensor:
        """high - low, float64 (d,)."""
        high, low = (torch.tensor(bound, dtype=torch.float64) for bound in (self.high, self.low))
        return high - low

    @cached_property
    def quantum(self) -> Tensor:
        """The smallest step that means something, a 255th of the span: float64 (d,)."""
        return self.span / 255


def axes_of(planes: Sequence[str]) -> Axes:
    """The axes of colour planes by name; ConfigError for a name that is none."""
    for name in planes:
        if name not in PLANES:
            raise unknown_name("plane", name, PLANES)
    chosen = [PLANES[name] for name in planes]
    return Axes(
        tuple(planes),
        tuple(float(plane.low) for plane in chosen),
        tuple(float(plane.high) for plane in chosen),
        tuple(plane.circular for plane in chosen),
    )


def circular_mean(hues: Tensor, weights: Tensor | None = None) -> Tensor:
    """The mean direction of hues (m,) in turns, in [0,1), by weights (m,) ≥ 0 if given.

    0 where the directions cancel. Where all weights are 0 they do not count.
    """
    angle = 2 * math.pi * hues.double()
    share = torch.ones_like(angle) if weights is None else weights.double()
    total = float(share.sum())
    if not total > 0:
        share, total = torch.ones_like(angle), float(len(angle))
    # Two numbers are left, and plain ones cost less than tensors of one value.
    sine, cosine = (float(torch.dot(share, part)) / total for part in (angle.sin(), angle.cos()))
    if math.hypot(sine, cosine) < MIN_MEAN_LENGTH:
        return hues.new_zeros(())
    mean = hues.new_tensor(math.atan2(sine, cosine) / (2 * math.pi) % 1)
    return torch.where(mean < 1, mean, 0)  # a tiny negative one is rounded to a whole turn


def mean_hues(planes: Tensor, axes: Axes) -> Tensor:
    """For each plane of (d,m) its circular mean; 0 if not circular: (d,).

    Weighted by saturation where S is one of the planes, as grey has a hue by convention alone.
    """
    if not any(axes.circular):
        return planes.new_zeros(len(axes))
    weights = planes[axes.names.index("S")].clamp_min(0) if "S" in axes.names else None
    pairs = zip(planes, axes.circular, strict=True)
    means = [circular_mean(row, weights) if round_ else row.new_zeros(()) for row, round_ in pairs]
    return torch.stack(means)


def unrolled(hues: Tensor, mean: Tensor | float) -> Tensor:
    """Hues in turns as their distance along the circle from a mean: -0.5 to 0.5."""
    turns = hues - mean
    return turns.sub_(turns.round())  # several times faster than a remainder


def arranged(planes: Tensor, axes: Axes, hue: Hue, means: Tensor) -> Tensor:
    """Planes (d,n) as the classifiers see them, hue by one of two readings: (d,n).

    means: (d,), those of ``mean_hues``.
    """
    if hue == "linear" or not any(axes.circular):
        return planes
    turned = planes - means[:, None]  # the one copy; means of what is not circular are 0
    for row, circular in zip(turned, axes.circular, strict=True):
        if circular:
            row.sub_(row.round())
    return turned


@cache
def arranged_axes(axes: Axes, hue: Hue) -> Axes:
    """The axes of arranged planes."""
    if hue == "linear":
        return axes
    low, high = (
        tuple(
            half if circular else bound for bound, circular in zip(ends, axes.circular, strict=True)
        )
        for ends, half in ((axes.low, -0.5), (axes.high, 0.5))
    )
    return Axes(axes.names, low, high, axes.circular)
