"""P3's distances of colours from a few samples of road, slow and simple, as its text states them.

Each function returns the distances of pixels (n,), greater is less road, and that of the boundary.

Choices that the text leaves open are those of docs/how/one_class.md: Huber's weight, the ridge,
the variance of rounding, starts of the mixture.
"""

import numpy as np
from scipy.optimize import linprog
from scipy.stats import chi2

from roadtorch.oneclass.base import rejection_distance
from tests.reference import oneclass_density as density
from tests.reference.oneclass_boundary import distance_matrix

Array = np.ndarray
REJECTED, RIDGE, ROUNDING = 0.025, 1e-3, (1 / 255) ** 2 / 12


def robust_gaussian(samples: Array, pixels: Array) -> tuple[Array, float]:
    """Return Mahalanobis distances; samples (m, d) far from the mean have less weight."""
    dimensions = samples.shape[1]
    reach = np.sqrt(chi2.ppf(1 - REJECTED, dimensions))
    mean = np.median(samples, 0)
    spread = 1.4826 * np.median(np.abs(samples - mean), 0)
    covariance = np.diag(spread**2 + ROUNDING)
    for _ in range(50):
        weights = reach / np.maximum(reach, mahalanobis(samples, mean, covariance))
        mean = weights @ samples / weights.sum()
        centred = weights[:, None] * (samples - mean)
        covariance = centred.T @ centred / (weights**2).sum()
        ridge = RIDGE * np.trace(covariance) / dimensions + ROUNDING
        covariance = (1 - RIDGE) * covariance + ridge * np.eye(dimensions)
    training = mahalanobis(samples, mean, covariance)
    return mahalanobis(pixels, mean, covariance), rejection_distance(training, REJECTED)


def mahalanobis(points: Array, mean: Array, covariance: Array) -> Array:
    """Return √((x-μ)ᵀ Σ⁻¹ (x-μ)), point by point."""
    inverse = np.linalg.inv(covariance)
    return np.array([np.sqrt((x - mean) @ inverse @ (x - mean)) for x in points])


def mog2(samples: Array, pixels: Array) -> tuple[Array, float]:
    """Return -ln Σ P_n exp(-(x-μ)ᵀ Σ⁻¹ (x-μ)) of pixels (n, d), without ½ and determinants."""
    return formula(likeliest_mixture(samples, 2)[1], samples, pixels)


def mog4(samples: Array, pixels: Array) -> tuple[Array, float]:
    """Return the distance of ``mog2`` with four Gaussians."""
    return formula(likeliest_mixture(samples, 4)[1], samples, pixels)


def mog_opt(samples: Array, pixels: Array) -> tuple[Array, float]:
    """Return it with one to six Gaussians by Schwarz's criterion, which P3 leaves open."""
    count, dimensions = samples.shape
    size = dimensions + dimensions * (dimensions + 1) // 2
    candidates = []
    for number in range(1, 7):
        likelihood, mixture = likeliest_mixture(samples, number)
        candidates.append((np.log(count) * (number - 1 + number * size) - 2 * likelihood, mixture))
    return formula(min(candidates, key=lambda pair: pair[0])[1], samples, pixels)


def likeliest_mixture(samples: Array, number: int) -> tuple[float, tuple[Array, Array, Array]]:
    """Return the log-likelihood, and weights, means, covariances of that number of Gaussians.

    Expectation maximisation from 20 random starts; the likeliest result is used.
    """
    random = np.random.default_rng(0)
    widening = 0.01 * ((samples - samples.mean(0)) ** 2).mean() + ROUNDING * np.ones(3)
    candidates = []
    for _ in range(20 if number > 1 else 1):
        centres = samples[random.choice(len(samples), number, replace=False)]
        nearest = distance_matrix(centres, samples).argmin(0)
        start = np.stack([nearest == component for component in range(number)]).astype(float)
        if start.sum(1).min() > 0:
            mixture = density.expectation_maximisation(samples, start, widening, 100)
            likelihood = density.log_sum(density.log_densities(samples, *mixture)).sum()
            candidates.append((float(likelihood), mixture))
    return max(candidates, key=lambda pair: pair[0])


def formula(
    mixture: tuple[Array, Array, Array], samples: Array, pixels: Array
) -> tuple[Array, float]:
    """Return P3's formula of a mixture, of pixels, and its boundary."""

    def distance(points: Array) -> Array:
        parts = [
            np.log(share) - mahalanobis(points, mean, covariance) ** 2
            for share, mean, covariance in zip(*mixture, strict=True)
        ]
        return -density.log_sum(np.stack(parts))

    return distance(pixels), rejection_distance(distance(samples), REJECTED)


def pca(samples: Array, pixels: Array) -> tuple[Array, float]:
    """Return |(x-μ) - PPᵀ(x-μ)|, P the eigenvectors with 95 % of the variance, possibly all."""
    mean = samples.mean(0)
    values, vectors = np.linalg.eigh(np.cov(samples.T))
    shares = np.cumsum(values[::-1]) / values.sum()
    basis = vectors[:, ::-1][:, : int(np.argmax(shares >= 0.95)) + 1]

    def distance(points: Array) -> Array:
        return np.linalg.norm((points - mean) - (points - mean) @ basis @ basis.T, axis=1)

    return distance(pixels), rejection_distance(distance(samples), REJECTED)


def dlp(samples: Array, pixels: Array) -> tuple[Array, float]:
    """Return Σ_j w_j |x - y_j|, with the least largest sum over most samples."""
    number = len(samples)
    among = distance_matrix(samples, samples)
    solution = linprog(  # w, ξ and ρ: min ρ + Σ ξ / (ν m) with Σ_j w_j d_ij ≤ ρ + ξ_i, Σ w = 1
        np.r_[np.zeros(number), np.full(number, 1 / (REJECTED * number)), 1],
        A_ub=np.c_[among, -np.eye(number), -np.ones(number)],
        b_ub=np.zeros(number),
        A_eq=np.r_[np.ones(number), np.zeros(number + 1)][None],
        b_eq=[1],
    )
    return distance_matrix(pixels, samples) @ solution.x[:number], float(solution.x[-1])
