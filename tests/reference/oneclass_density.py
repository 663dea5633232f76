"""Density and reconstruction classifiers, slow and simple."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


def log_sum(exponents: Array) -> Array:
    """Return ln Σ exp over the first axis."""
    top = exponents.max(0)
    return top + np.log(np.exp(exponents - top).sum(0))


def histogram_distance(samples: Array, pixels: Array, bins: int) -> Array:
    """Return √(2 ln(peak/p)) from numpy.histogramdd, of planes from 0 to 1."""
    counts, _ = np.histogramdd(samples, bins, [(0, 1)] * samples.shape[1])
    places = tuple(np.clip((pixels.T * bins).astype(int), 0, bins - 1))
    with np.errstate(divide="ignore"):
        return np.sqrt(2 * np.log(counts.max() / counts[places]))


def histograms_distance(samples: Array, pixels: Array) -> Array:
    """Return it with the product of one histogram of 64 bins for each plane."""
    columns = zip(samples.T[..., None], pixels.T[..., None], strict=True)
    return np.sqrt(sum(histogram_distance(*column, bins=64) ** 2 for column in columns))


def residual_distance(samples: Array, pixels: Array, count: int) -> Array:
    """Return the residual of pixels after ``count`` principal components; -1: all but the last."""
    mean = samples.mean(0)
    basis = np.linalg.svd(samples - mean)[2][:count]
    return np.linalg.norm(pixels - mean - (pixels - mean) @ basis.T @ basis, axis=1)


def squared_distances(points: Array, means: Array, covariances: Array) -> Array:
    """Return (x-μ)ᵀ Σ⁻¹ (x-μ) of points (n, d) for each of N Gaussians: (N, n)."""
    away = points - means[:, None]
    return ((away @ np.linalg.inv(covariances)) * away).sum(2)


def gaussian_distance(samples: Array, pixels: Array, floor: float) -> Array:
    """Use the regularised covariance of dd_tools (ridge 0.001), and a variance floor."""
    covariance = np.atleast_2d(np.cov(samples.T, ddof=1))
    added = 1e-3 * np.trace(covariance) / len(covariance) + floor
    covariance = 0.999 * covariance + added * np.eye(len(covariance))
    return np.sqrt(squared_distances(pixels, samples.mean(0)[None], covariance[None])[0])


def log_densities(points: Array, shares: Array, means: Array, covariances: Array) -> Array:
    """Return ln P_n N(x; μ_n, Σ_n) of points (n, d): (N, n)."""
    heights = np.log(shares) - np.linalg.slogdet(2 * np.pi * covariances)[1] / 2
    return heights[:, None] - squared_distances(points, means, covariances) / 2


def expectation_maximisation(
    samples: Array, memberships: Array, widening: Array, rounds: int
) -> tuple[Array, Array, Array]:
    """Return weights, means and covariances after some rounds, one component at a time."""
    parts = (np.empty(0), np.empty(0), np.empty(0))
    for number in range(rounds):
        if number:
            logs = log_densities(samples, *parts)
            memberships = np.exp(logs - log_sum(logs))
        covariances = [
            np.cov(samples.T, aweights=row, ddof=0) + np.diag(widening) for row in memberships
        ]
        means = np.stack([np.average(samples, 0, row) for row in memberships])
        parts = memberships.sum(1) / len(samples), means, np.stack(covariances)
    return parts


def least_radius(apart: Array, count: int) -> float:
    """Return the least largest distance to the nearest of ``count`` centres, over all choices."""
    return min(
        float(apart[list(centres)].min(0).max())
        for centres in combinations(range(len(apart)), count)
    )
