"""Interface of the one-class classifiers (P3, section III-B).

A ``Classifier`` consists of a model of settings and a function that fits it to samples of road and
returns a distance of pixels from them. Checks, chunks, thresholds and likelihoods are shared, here.

The distance is ≥ 0: lower is more road-like, infinity is allowed. A density p gives √(2
ln(peak/p)), where peak is at least its maximum; for one Gaussian that is the Mahalanobis distance.
P3 asks for a likelihood in [0, 1] but states distances for most classifiers; here all of them have

    likelihood = 1 / (1 + √(distance / t))

with t the distance that a given fraction of the training samples exceeds. It is strictly
decreasing, and 0.5 at the threshold; its log-odds are -½ ln(distance/t). Unlike exp(-distance) it
neither underflows nor maps distant pixels to a few of the 65,536 levels of a 16-bit image; without
the root, a tight threshold still does.
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
from roadtorch.oneclass.axes import Axes, Hue, arrange_planes, arranged_axes, mean_hues

CHUNK_FLOATS = 700_000
"""Floats of the largest tensor while pixels are scored: 2.8 MB, which fits the CPU's cache."""

PROBES = 16  # number of samples around which the distance of one quantum is measured
ROUNDING = 1e-3  # fraction of one quantum's distance below which a threshold is due to rounding


class ClassifierSettings(Settings):
    """Settings of all one-class classifiers."""

    rejected: float = Field(
        default=0.025,
        ge=0,
        le=1,
        description="fraction of the training samples beyond the threshold; the paper: 0.025 for "
        "the Gaussians, unspecified for the rest",
    )
    hue: Hue = Field(
        default="unrolled",
        description="hue along the circle from the mean hue, or as a plain number (suggested by "
        "the paper's results)",
    )


@dataclass(frozen=True, eq=False)
class RoadSamples:
    """Training data of a classifier.

    ``samples`` are finite float64 (m, d), m ≥ 1, on ``axes`` where hue is an ordinary number;
    ``generator`` is the only source of randomness.
    """

    samples: Tensor
    axes: Axes
    generator: torch.Generator


@dataclass(frozen=True, eq=False)
class DistanceModel:
    """Distance function of a fitted classifier.

    Attributes:
        distance: function of pixels float32 (d, n) to distances (n,) ≥ 0, called chunk by chunk.
            Its values for non-finite pixels are ignored.
        floats: size of the largest tensor per pixel, in float32; sets the size of chunks.
        training: distances of the training samples, where they are not simply scored
            (leave-one-out, lengths of edges).
        threshold: distance of the boundary, where the classifier defines one.
    """

    distance: Callable[[Tensor], Tensor]
    floats: int
    training: Tensor | None = None
    threshold: float | None = None

    def chunked_distance(self, planes: Tensor) -> Tensor:
        """Return distances (n,) of finite pixels (d, n) from ``arrange_planes``, in chunks."""
        length = max(1, CHUNK_FLOATS // max(1, self.floats))
        return _concatenate([self.distance(part) for part in planes.split(length, 1)])


@dataclass(frozen=True)
class Classifier:
    """A one-class classifier, with its name and summary in lists and its class of settings.

    ``fit`` handles one sample, identical samples, constant planes and fewer samples than
    dimensions. ``single_plane_error`` is the reason why it needs several planes, empty if it does
    not. ``paper`` has the settings that reproduce P3, where they are not the defaults.
    """

    name: str
    summary: str
    settings: type[ClassifierSettings]
    fit: Callable[[RoadSamples, Any], DistanceModel]
    single_plane_error: str = ""
    paper: Mapping[str, object] = field(default_factory=dict, hash=False)

    def refusal(self, planes: int) -> str:
        """Return why it cannot work with that number of planes, or an empty string."""
        return self.single_plane_error if planes == 1 else ""


@dataclass(frozen=True, eq=False)
class FittedClassifier:
    """A classifier fitted to samples by ``fit``.

    ``hues`` (d,) are the mean hues of circular axes, else 0; ``threshold`` () is the distance of
    the boundary.
    """

    axes: Axes
    hue: Hue
    hues: Tensor
    model: DistanceModel
    threshold: Tensor

    @torch.no_grad()
    def distance(self, pixels: Tensor) -> Tensor:
        """Return the distances of pixels (n, d) from the samples: float32 (n,), ≥ 0.

        Infinite for pixels with a non-finite value. Fastest where pixels are a view of planes,
        ``planes.flatten(1).T``. Memory grows with the result only. Raises InputError for another
        number of planes than that of the samples.
        """
        _check_table("pixels", pixels, len(self.axes))
        planes = pixels.T.to(torch.float32)
        distances = []
        for part in planes.split(max(1, CHUNK_FLOATS // len(planes)), 1):
            # A sum is finite where all its parts are (values near 1e38 do not occur).
            broken = None if math.isfinite(float(part.sum())) else ~part.sum(0).isfinite()
            finite = part if broken is None else torch.where(broken, 0, part)
            distance = self.model.chunked_distance(
                arrange_planes(finite, self.axes, self.hue, self.hues)
            )
            distances.append(distance if broken is None else distance.masked_fill(broken, math.inf))
        return _concatenate(distances)

    def likelihood(self, pixels: Tensor) -> Tensor:
        """Return 1 / (1 + √(distance/t)) of pixels (n, d): float32 (n,), 0.5 at the threshold."""
        return self.to_likelihood(self.distance(pixels))

    def to_likelihood(self, distance: Tensor) -> Tensor:
        """Convert distances of any shape to likelihoods."""
        return (distance / self.threshold).sqrt_().add_(1).reciprocal_()


def _concatenate(parts: list[Tensor]) -> Tensor:
    return parts[0] if len(parts) == 1 else torch.cat(parts)


def fit(
    classifier: Classifier,
    samples: Tensor,
    axes: Axes,
    settings: ClassifierSettings | None = None,
    generator: torch.Generator | None = None,
) -> FittedClassifier:
    """Fit a classifier to samples of road; samples with a non-finite value are ignored.

    samples: floating point, in the units of the axes, shape (m, d). settings: None for the
    classifier's defaults. generator: source of randomness; None for one seeded with 0.

    Raises:
        InputError: when the shape or type is wrong, or no sample is finite.
        ConfigError: when the classifier cannot work with that number of planes.
    """
    settings = classifier.settings() if settings is None else settings
    generator = torch.Generator().manual_seed(0) if generator is None else generator
    if reason := classifier.refusal(len(axes)):
        raise ConfigError(classifier.name, reason, "choose other planes or another classifier")
    _check_table("samples", samples, len(axes))
    samples = samples.detach().to(torch.float32)  # the type of scored pixels
    if not math.isfinite(float(samples.sum())):
        samples = samples[samples.isfinite().all(1)]
    if not len(samples):
        raise InputError("samples", "none has finite values", "give at least one sample of road")
    hues = mean_hues(samples.T, axes)
    inner = arranged_axes(axes, settings.hue)
    planes = arrange_planes(samples.T, axes, settings.hue, hues)
    model = classifier.fit(RoadSamples(planes.T.double(), inner, generator), settings)
    threshold = _threshold(model, planes, inner, settings.rejected)
    return FittedClassifier(
        axes, settings.hue, hues, model, torch.tensor(threshold, dtype=torch.float32)
    )


def _check_table(where: str, values: Tensor, dimensions: int) -> None:
    if not values.is_floating_point():
        raise InputError(where, f"are {values.dtype}", "give a floating point tensor")
    if values.ndim != 2 or values.shape[1] != dimensions:
        problem = f"have the shape {tuple(values.shape)}"
        raise InputError(where, problem, f"give (number, {dimensions}), one column per plane")


def rejection_distance(distances: np.ndarray, rejected: float) -> float:
    """Return the distance that a fraction of the training distances (m,) exceeds.

    Midway between the k-th and the next in increasing order, k = ⌊(1-rejected)·m + ½⌋; the first or
    the last where there is no next.
    """
    ordered, count = np.sort(distances), len(distances)
    rank = math.floor((1 - rejected) * count + 0.5)
    return float(ordered[max(0, rank - 1) : rank + 1].mean(dtype=np.float64))


def _threshold(model: DistanceModel, samples: Tensor, axes: Axes, rejected: float) -> float:
    """Return the boundary of samples (d, m), or one quantum's distance where that is 0.

    Samples of one colour all have distance 0: then pixels within about one quantum are accepted.
    """
    probes = samples[:, :: math.ceil(samples.shape[1] / PROBES)]
    near = (probes[..., None] + _quantum_steps(axes)).flatten(1)
    has_boundary = model.threshold is not None or model.training is not None
    # In one call: for few samples a call costs more than the computation.
    pixels = near if has_boundary else torch.cat([samples, near], 1)
    training, steps = np.split(model.chunked_distance(pixels).numpy(), [-near.shape[1]])
    threshold = model.threshold
    if threshold is None:
        training = training if model.training is None else model.training.numpy()
        threshold = rejection_distance(training, rejected)
    steps = np.sort(steps[np.isfinite(steps) & (steps > 0)])
    quantum = float(steps[(len(steps) - 1) // 2]) if len(steps) else 1.0
    return threshold if math.isfinite(threshold) and threshold > ROUNDING * quantum else quantum


@cache
@torch.inference_mode(False)  # cached for callers in any mode
def _quantum_steps(axes: Axes) -> Tensor:
    """Return one quantum up and down each plane, float32 (d, 1, 2d)."""
    steps = torch.diag(axes.quantum).float()
    return torch.cat([steps, -steps], 1)[:, None]
