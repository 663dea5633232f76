"""One-class classifiers by density: the Gaussian and the robust Gaussian (P3).

Fits are in float64, whatever the samples; pixels are scored in float32.
"""

from functools import cache
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.oneclass.axes import Axes
from roadtorch.oneclass.base import Classifier, ClassifierSettings, Learned, Road

MAX_STEPS = 50
"""Rounds of reweighting at most."""

TOLERANCE = 1e-5
"""Reweighting ends when the mean moves by less than this share of a plane's span, a quarter
of a hundredth of a level."""


class GaussianSettings(ClassifierSettings):
    """A single Gaussian."""

    ridge: float = Field(
        default=1e-3, ge=0, le=1, description="share of the mean variance mixed into the covariance"
    )
    threshold: Literal["quantile", "chi2"] = Field(
        default="quantile",
        description="beyond it lies the rejected fraction of the samples, or of a Gaussian (of the "
        "samples if the fraction is 0)",
    )


@cache
@torch.inference_mode(False)  # kept for callers in any mode
def floor_of(axes: Axes) -> Tensor:
    """The variance that rounding to 256 levels alone causes, quantum²/12: float64 (d,).

    Added to covariances, so that constant planes give a finite, ordered distance.
    """
    return axes.quantum.square() / 12


def moments(samples: Tensor, weights: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Mean (d,) and covariance (d,d) of samples (m,d), divisor m-1 (0 for one sample).

    With weights w (m,): Σwx/Σw, and the covariance Σw²(x-mean)(x-mean)ᵀ/Σw² about it.
    """
    if weights is None:
        mean = samples.mean(0)
        centred = samples - mean
        return mean, centred.T @ centred / max(1, len(samples) - 1)
    mean = weights @ samples / weights.sum()
    centred = weights[:, None] * (samples - mean)
    return mean, centred.T @ centred / weights.square().sum()


def regularised(covariance: Tensor, ridge: float, floor: Tensor) -> Tensor:
    """(1-r)Σ + r·(tr Σ/d)·I + diag(floor): what dd_tools does, and a floor of variance."""
    added = floor + ridge * covariance.diagonal().mean()
    return (1 - ridge) * covariance + torch.diag(added)


def whitening(covariance: Tensor) -> Tensor:
    """W (…,d,d) with Wᵀ W = Σ⁻¹, so that |W(x-mean)| is the Mahalanobis distance."""
    root = torch.linalg.cholesky(covariance)
    identity = torch.eye(root.shape[-1]).to(root).expand_as(root)
    return torch.linalg.solve_triangular(root, identity, upper=False)


def chi_quantile(share: float, dimensions: int) -> float:
    """The Mahalanobis distance within which a Gaussian has that share of its samples."""
    from scipy.special import gammaincinv  # scipy.stats has chi2, and is slow to import

    # Half of the squared distance has a gamma distribution.
    return float(2 * gammaincinv(dimensions / 2, share)) ** 0.5


def mahalanobis(samples: Tensor, mean: Tensor, covariance: Tensor) -> Tensor:
    """√((x-mean)ᵀ Σ⁻¹ (x-mean)) of samples (m,d): (m,)."""
    return ((samples - mean) @ whitening(covariance).T).norm(dim=1)


def length_of(planes: Tensor) -> Tensor:
    """The Euclidean length of each column of planes (d,n): (n,). Overwrites the planes.

    Plane by plane, which is ten times as fast as a norm along the first axis.
    """
    total = planes[0].square_()
    for plane in planes[1:]:
        total.addcmul_(plane, plane)
    return total.sqrt_()


def gaussian(mean: Tensor, covariance: Tensor, settings: GaussianSettings) -> Learned:
    """The Mahalanobis distance |W(x-mean)|, of a mean (d,) and a covariance (d,d).

    P3 announces the density G(x, μ, σ) and writes down (x-μ)ᵀΣ⁻¹(x-μ); both rank alike.
    """
    exact = whitening(covariance)
    root, offset = exact.float().contiguous(), (-exact @ mean)[:, None].float().contiguous()
    threshold = None
    if settings.threshold == "chi2" and settings.rejected > 0:
        threshold = chi_quantile(1 - settings.rejected, len(mean))

    def distance(pixels: Tensor) -> Tensor:
        if len(pixels) == 1:
            slope = float(root)  # a factor of the sum, which takes no pass of its own
            return torch.add(offset[0], pixels[0], alpha=slope).abs_()
        return length_of(torch.addmm(offset, root, pixels))

    return Learned(distance, len(mean) + 1, threshold=threshold)


def fit_gaussian(road: Road, settings: GaussianSettings) -> Learned:
    """Mean and covariance of the samples."""
    mean, covariance = moments(road.samples)
    covariance = regularised(covariance, settings.ridge, floor_of(road.axes))
    return gaussian(mean, covariance, settings)


class RobustSettings(GaussianSettings):
    """A Gaussian that outliers among the samples move little."""

    method: Literal["reweighted", "huber"] = Field(
        default="reweighted",
        description="how far samples lose weight: by their distance to the power of 1.5 (ours), or "
        "of 1 (huber, the reading of P3's text)",
    )


def reweighted(
    samples: Tensor, axes: Axes, settings: GaussianSettings, power: float
) -> tuple[Tensor, Tensor]:
    """Mean and covariance with weights w = min(1, (c/D)^power), c² = χ²_d(1-rejected).

    P3: samples "weighted according to their proximity to the mean", "rejecting 2.5 %"; so
    c is where a Gaussian has 2.5 % outside. D is the Mahalanobis distance, the covariance has
    weights w². Power 1 is Huber's, the plainest reading of both sentences (``huber``): far samples
    never lose all of their pull on the covariance, and 10 % of them are too many in three planes.
    Power 1.5 (``reweighted``, ours, the default) lets go of them, and of clean samples it says what
    the plain Gaussian says: what it gains is not P3's. Starts at the median with the median
    absolute deviations, which few outliers change.
    """
    reach = chi_quantile(1 - min(max(settings.rejected, 1e-6), 1 - 1e-6), len(axes))
    floor, limit = floor_of(axes), TOLERANCE * axes.span
    mean = samples.median(0).values
    spread = 1.4826 * (samples - mean).abs().median(0).values
    covariance = torch.diag(spread.square() + floor)
    for _ in range(MAX_STEPS):
        distances = mahalanobis(samples, mean, covariance)
        weights = (reach / distances.clamp_min(reach)) ** power
        before = mean
        mean, covariance = moments(samples, weights)
        covariance = regularised(covariance, settings.ridge, floor)
        if bool(((mean - before).abs() <= limit).all()):
            break
    return mean, covariance


def fit_robust(road: Road, settings: RobustSettings) -> Learned:
    """Mean and covariance of the weighted samples."""
    power = 1.5 if settings.method == "reweighted" else 1.0
    return gaussian(*reweighted(road.samples, road.axes, settings, power), settings)


CLASSIFIERS = (
    Classifier("gaussian", "Mahalanobis distance", GaussianSettings, fit_gaussian),
    Classifier(
        "robust_gaussian",
        "Mahalanobis distance, outliers weighed down by a power of ours",
        RobustSettings,
        fit_robust,
        paper={"method": "huber"},
    ),
)
"""The single Gaussians of P3."""
