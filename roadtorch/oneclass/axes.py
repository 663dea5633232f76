"""Axes: the planes of samples and pixels, with hue as a circle.

P3 mentions circular distances as a possibility and does not say which it used. Here hue becomes an
ordinary number before classification, so that every classifier can treat it as a circle.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import torch
from torch import Tensor

from roadtorch.base.errors import unknown_name_error
from roadtorch.imaging.color import PLANES

Hue = Literal["unrolled", "linear"]
"""Reading of hue: distance along the circle from the samples' mean, or a plain number.

``unrolled`` is exact within half a turn; ``linear`` is cut at red, as P3's column H suggests.
"""

MIN_MEAN_LENGTH = 1e-6  # length of the mean vector below which hues have no mean, and 0 is used


@dataclass(frozen=True)
class Axes:
    """The planes of samples and pixels: names, bounds, and whether high is the same as low."""

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    circular: tuple[bool, ...]

    def __len__(self) -> int:
        """Return the number of planes."""
        return len(self.names)

    @cached_property
    def span(self) -> Tensor:
        """Range of each plane, high - low, float64 (d,)."""
        high, low = (torch.tensor(bound, dtype=torch.float64) for bound in (self.high, self.low))
        return high - low

    @cached_property
    def quantum(self) -> Tensor:
        """Smallest meaningful step of each plane, a 255th of its span: float64 (d,)."""
        return self.span / 255


def make_axes(planes: Sequence[str]) -> Axes:
    """Return the axes of colour planes by name; raise ConfigError for an unknown one."""
    for name in planes:
        if name not in PLANES:
            raise unknown_name_error("plane", name, PLANES)
    infos = [PLANES[name] for name in planes]
    return Axes(
        tuple(planes),
        tuple(float(plane.low) for plane in infos),
        tuple(float(plane.high) for plane in infos),
        tuple(plane.circular for plane in infos),
    )


def circular_mean(hues: Tensor, weights: Tensor | None = None) -> Tensor:
    """Return the mean direction of hues (m,) in turns, in [0, 1), by weights (m,) ≥ 0.

    0 where the directions cancel. Weights that are all 0 are ignored.
    """
    angle = 2 * math.pi * hues.double()
    weight = torch.ones_like(angle) if weights is None else weights.double()
    total = float(weight.sum())
    if not total > 0:
        weight, total = torch.ones_like(angle), float(len(angle))
    # Floats are faster than tensors of one value.
    sine, cosine = (float(torch.dot(weight, part)) / total for part in (angle.sin(), angle.cos()))
    if math.hypot(sine, cosine) < MIN_MEAN_LENGTH:
        return hues.new_zeros(())
    mean = hues.new_tensor(math.atan2(sine, cosine) / (2 * math.pi) % 1)
    return torch.where(mean < 1, mean, 0)  # a tiny negative mean is rounded to 1


def mean_hues(planes: Tensor, axes: Axes) -> Tensor:
    """Return the circular mean of each plane of (d, m), 0 for planes that are not circular: (d,).

    Weighted by saturation if S is one of the planes: the hue of grey is arbitrary.
    """
    if not any(axes.circular):
        return planes.new_zeros(len(axes))
    weights = planes[axes.names.index("S")].clamp_min(0) if "S" in axes.names else None
    pairs = zip(planes, axes.circular, strict=True)
    means = [circular_mean(row, weights) if wraps else row.new_zeros(()) for row, wraps in pairs]
    return torch.stack(means)


def unroll_hue(hues: Tensor, mean: Tensor | float) -> Tensor:
    """Return hues in turns as their signed distance along the circle from a mean, -0.5 to 0.5."""
    turns = hues - mean
    return turns.sub_(turns.round())  # faster than a remainder


def arrange_planes(planes: Tensor, axes: Axes, hue: Hue, means: Tensor) -> Tensor:
    """Return planes (d, n) for classifiers, hue relative to ``means`` (d,) from ``mean_hues``."""
    if hue == "linear" or not any(axes.circular):
        return planes
    turned = planes - means[:, None]  # the only copy; other means are 0
    for row, circular in zip(turned, axes.circular, strict=True):
        if circular:
            row.sub_(row.round())
    return turned


@cache
def arranged_axes(axes: Axes, hue: Hue) -> Axes:
    """Return the axes of the planes from ``arrange_planes``."""
    if hue == "linear":
        return axes
    low, high = (
        tuple(
            half if circular else bound for bound, circular in zip(ends, axes.circular, strict=True)
        )
        for ends, half in ((axes.low, -0.5), (axes.high, 0.5))
    )
    return Axes(axes.names, low, high, axes.circular)
