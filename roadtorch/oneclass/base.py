"""The contract of the one-class classifiers (P3, section III-B).

A classifier is described by a ``Classifier``: a model of settings, and a function that fits it
to samples of road and returns what tells how far pixels are from them. All the rest is here,
once: checks, chunks, thresholds, likelihoods.

Every classifier answers with a distance ≥ 0: lower is more road-like, infinite is allowed.
A density p answers with √(2 ln(peak/p)), where peak is no less than its largest value; for
one Gaussian that is the Mahalanobis distance. P3 asks for a likelihood in [0,1] but writes
down distances for most classifiers; here all of them have

    likelihood = 1 / (1 + √(distance / t))

with t the distance that a given fraction of the training samples exceeds. It is strictly
decreasing and 0.5 lies at the threshold; its log-odds are -½ ln(distance/t). Unlike
exp(-distance) it neither underflows nor crowds the far pixels on a few of the 65,536 levels
that a 16-bit map can hold; without the root, a tight threshold still does.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.settings import Settings
from roadtorch.oneclass.axes import Axes, Hue, arranged, arranged_axes, mean_hues

CHUNK = 700_000
"""Floats of the largest tensor while pixels are scored: 2.8 MB, which stays in the cache."""

PROBES = 16
"""Samples around which the distance of one quantum is measured."""

ROUNDING = 1e-3
"""A threshold below this share of one quantum's distance comes from rounding alone."""


class ClassifierSettings(Settings):
    """What every one-class classifier can be told."""

    rejected: float = Field(
        default=0.025,
        ge=0,
        le=1,
        description="fraction of the training samples beyond the threshold; the paper has 0.025 "
        "for the Gaussians and nothing for the others",
    )
    hue: Hue = Field(
        default="unrolled",
        description="hue along the circle from the mean hue, or as a plain number (as the paper's "
        "results suggest)",
    )


@dataclass(frozen=True)
class Road:
    """What a classifier learns from: samples float64 (m,d), m ≥ 1, all finite.

    axes: of the samples, hue already an ordinary number. generator: where all chance comes from.
    """

    samples: Tensor
    axes: Axes
    generator: torch.Generator


@dataclass(frozen=True)
class Learned:
    """What fitting gives.

    distance: pixels float32 (d,n) to (n,), ≥ 0; called chunk by chunk. What it says of values
        that are not finite does not matter.
    floats: the largest tensor made while a pixel is scored, in float32; sets the chunks.
    training: distances of the training samples, any number of them, where these are not
        simply scored (leave-one-out, lengths of edges).
    threshold: the distance of the boundary, where the classifier has one of its own.
    """

    distance: Callable[[Tensor], Tensor]
    floats: int
    training: Tensor | None = None
    threshold: float | None = None

    def chunked_distance(self, planes: Tensor) -> Tensor:
        """The distance of finite pixels (d,n), arranged, in chunks that stay in the cache: (n,)."""
        length = max(1, CHUNK // max(1, self.floats))
        return _joined([self.distance(part) for part in planes.split(length, 1)])


@dataclass(frozen=True)
class Classifier:
    """One classifier on offer.

    name, summary: for lists. settings: the model of its settings.
    fit: it must cope with one sample, identical samples, constant planes and fewer samples than
        dimensions.
    single: why it cannot work with a single plane; empty where it can.
    paper: settings with which it is P3's to the letter, where its defaults are not.
    """

    name: str
    summary: str
    settings: type[ClassifierSettings]
    fit: Callable[[Road, Any], Learned]
    single: str = ""
    paper: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def refuses(self, planes: int) -> str:
        """Why it cannot work with so many planes; empty where it can."""
        return self.single if planes == 1 else ""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A classifier that has seen samples on some axes; made by ``fit``.

    hues: (d,), the mean hue of circular axes, else 0. threshold: the distance of the boundary, ().
    """

    axes: Axes
    hue: Hue
    hues: Tensor
    learned: Learned
    threshold: Tensor

    @torch.no_grad()
    def distance(self, pixels: Tensor) -> Tensor:
        """How far pixels (n,d) are from what was learned: float32 (n,), ≥ 0.

        Infinite for pixels with a value that is not finite. Fastest where pixels are a view
        of planes, ``planes.flatten(1).T``. Memory grows with the result alone, which many pixels
        take twice.
        Raises InputError for another number of planes than that of the samples.
        """
        _check_table("pixels", pixels, len(self.axes))
        planes = pixels.T.to(torch.float32)
        distances = []
        for part in planes.split(max(1, CHUNK // len(planes)), 1):
            # A sum is finite where all its parts are (values near 1e38 do not occur).
            broken = None if math.isfinite(float(part.sum())) else ~part.sum(0).isfinite()
            finite = part if broken is None else torch.where(broken, 0, part)
            distance = self.learned.chunked_distance(
                arranged(finite, self.axes, self.hue, self.hues)
            )
            distances.append(distance if broken is None else distance.masked_fill(broken, math.inf))
        return _joined(distances)

    def likelihood(self, pixels: Tensor) -> Tensor:
        """1 / (1 + √(distance/t)) of pixels (n,d): float32 (n,) in [0,1], 0.5 at the threshold."""
        return self.squashed(self.distance(pixels))

    def squashed(self, distance: Tensor) -> Tensor:
        """The likelihood that belongs to a distance, any shape."""
        return (distance / self.threshold).sqrt_().add_(1).reciprocal_()


def _joined(parts: list[Tensor]) -> Tensor:
    return parts[0] if len(parts) == 1 else torch.cat(parts)


def fit(
    classifier: Classifier,
    samples: Tensor,
    axes: Axes,
    settings: ClassifierSettings | None = None,
    generator: torch.Generator | None = None,
) -> Fitted:
    """Fit a classifier to samples (m,d), floating point, in the units of the axes.

    Samples with a value that is not finite are left out. Without settings the classifier's
    defaults hold; without a generator, one seeded with 0. Raises InputError when the shape
    is wrong or no sample is left, ConfigError when the classifier refuses so many planes.
    """
    settings = classifier.settings() if settings is None else settings
    generator = torch.Generator().manual_seed(0) if generator is None else generator
    if reason := classifier.refuses(len(axes)):
        raise ConfigError(classifier.name, reason, "choose other planes or another classifier")
    _check_table("samples", samples, len(axes))
    samples = samples.detach().to(torch.float32)  # the type in which pixels are scored
    if not math.isfinite(float(samples.sum())):
        samples = samples[samples.isfinite().all(1)]
    if not len(samples):
        raise InputError("samples", "none has finite values", "give at least one sample of road")
    hues = mean_hues(samples.T, axes)
    inner = arranged_axes(axes, settings.hue)
    planes = arranged(samples.T, axes, settings.hue, hues)
    learned = classifier.fit(Road(planes.T.double(), inner, generator), settings)
    threshold = _threshold(learned, planes, inner, settings.rejected)
    return Fitted(axes, settings.hue, hues, learned, torch.tensor(threshold, dtype=torch.float32))


def _check_table(where: str, values: Tensor, dimensions: int) -> None:
    if not values.is_floating_point():
        raise InputError(where, f"are {values.dtype}", "give a floating point tensor")
    if values.ndim != 2 or values.shape[1] != dimensions:
        problem = f"have the shape {tuple(values.shape)}"
        raise InputError(where, problem, f"give (number, {dimensions}), one column per plane")


def rejecting_distance(distances: np.ndarray, rejected: float) -> float:
    """The distance beyond which a fraction of the training distances (m,) lies.

    Midway between the k-th and the next in increasing order, k = ⌊(1-rejected)·m + ½⌋; the
    first or the last where there is none beside it.
    """
    ordered, count = np.sort(distances), len(distances)
    kept = math.floor((1 - rejected) * count + 0.5)
    return float(ordered[max(0, kept - 1) : kept + 1].mean(dtype=np.float64))


def _threshold(learned: Learned, samples: Tensor, axes: Axes, rejected: float) -> float:
    """The boundary of the training samples; one quantum's distance where that says nothing.

    Samples of one colour are all at distance 0. Then everything within about one quantum
    of that colour is accepted. samples: (d,m) on the axes as the classifier sees them.
    """
    probes = samples[:, :: math.ceil(samples.shape[1] / PROBES)]
    near = (probes[..., None] + _moves(axes)).flatten(1)
    known = learned.threshold is not None or learned.training is not None
    # In one go: for few samples a call costs more than what it computes.
    asked = near if known else torch.cat([samples, near], 1)
    distances = learned.chunked_distance(asked).numpy()
    training, steps = np.split(distances, [-near.shape[1]])
    threshold = learned.threshold
    if threshold is None:
        training = training if learned.training is None else learned.training.numpy()
        threshold = rejecting_distance(training, rejected)
    steps = np.sort(steps[np.isfinite(steps) & (steps > 0)])
    reach = float(steps[(len(steps) - 1) // 2]) if len(steps) else 1.0
    return threshold if math.isfinite(threshold) and threshold > ROUNDING * reach else reach


@cache
@torch.inference_mode(False)  # kept for callers in any mode
def _moves(axes: Axes) -> Tensor:
    """One quantum up and down every plane, float32 (d,1,2d)."""
    steps = torch.diag(axes.quantum).float()
    return torch.cat([steps, -steps], 1)[:, None]
