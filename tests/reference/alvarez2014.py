"""P3's distances of colours from a few samples of road, slow and obvious, as its text has them.

Each gives the distances of pixels (n,), greater is less road, and the one of the boundary.

What the text leaves open is that of docs/research/papers.md: Huber's weight, the ridge, the
variance of rounding, starts of the mixture.
"""

import numpy as np
from scipy.optimize import linprog
from scipy.stats import chi2

from roadtorch.oneclass.base import rejecting_distance
from tests.reference import oneclass_density as density
from tests.reference.oneclass_boundary import distance_matrix

Array = np.ndarray
REJECTED, RIDGE, ROUNDING = 0.025, 1e-3, (1 / 255) ** 2 / 12


def robust_gaussian(samples: Array, pixels: Array) -> tuple[Array, float]:
    """Mahalanobis distances; samples (m,d) weigh less the farther from the mean they are."""
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
    own = mahalanobis(samples, mean, covariance)
    return mahalanobis(pixels, mean, covariance), rejecting_distance(own, REJECTED)


def mahalanobis(points: Array, mean: Array, covariance: Array) -> Array:
    """√((x-μ)ᵀ Σ⁻¹ (x-μ)), point by point."""
    inverse = np.linalg.inv(covariance)
    return np.array([np.sqrt((x - mean) @ inverse @ (x - mean)) for x in points])


def mog2(samples: Array, pixels: Array) -> tuple[Array, float]:
    """-ln Σ P_n exp(-(x-μ)ᵀ Σ⁻¹ (x-μ)) of pixels (n,d): no ½ and no determinant.

    Expectation maximisation from 20 random pairs of samples, of which the likeliest stays.
    """
    random = np.random.default_rng(0)
    widening = 0.01 * ((samples - samples.mean(0)) ** 2).mean() + ROUNDING * np.ones(3)
    found = []
    for _ in range(20):
        pair = samples[random.choice(len(samples), 2, replace=False)]
        nearest = distance_matrix(pair, samples).argmin(0)
        if 2 < nearest.sum() < len(samples) - 2:
            start = np.stack([nearest == 0, nearest == 1]).astype(float)
            mixture = density.expectation_maximisation(samples, start, widening, 100)
            found.append((density.log_sum(density.log_parts(samples, *mixture)).sum(), mixture))
    shares, means, covariances = max(found, key=lambda pair: pair[0])[1]

    def distance(points: Array) -> Array:
        parts = [
            np.log(share) - mahalanobis(points, mean, covariance) ** 2
            for share, mean, covariance in zip(shares, means, covariances, strict=True)
        ]
        return -density.log_sum(np.stack(parts))

    return distance(pixels), rejecting_distance(distance(samples), REJECTED)


def dlp(samples: Array, pixels: Array) -> tuple[Array, float]:
    """Σ_j w_j |x - y_j|: the weights with the least largest sum over the samples, but for a few."""
    number = len(samples)
    among = distance_matrix(samples, samples)
    found = linprog(  # w, ξ and ρ: min ρ + Σ ξ / (ν m) with Σ_j w_j d_ij ≤ ρ + ξ_i, Σ w = 1
        np.r_[np.zeros(number), np.full(number, 1 / (REJECTED * number)), 1],
        A_ub=np.c_[among, -np.eye(number), -np.ones(number)],
        b_ub=np.zeros(number),
        A_eq=np.r_[np.ones(number), np.zeros(number + 1)][None],
        b_eq=[1],
    )
    return distance_matrix(pixels, samples) @ found.x[:number], float(found.x[-1])
