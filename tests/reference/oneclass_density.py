"""Slow, obvious versions of the density and reconstruction classifiers, and of the contract."""

import math
from itertools import combinations

import numpy as np
from scipy.stats import multivariate_normal


def log_sum(exponents: np.ndarray) -> np.ndarray:
    """ln Σ exp over the first axis."""
    top = exponents.max(0)
    return top + np.log(np.exp(exponents - top).sum(0))


def rejecting_distance(distances: np.ndarray, rejected: float) -> float:
    """Midway between the last sample that is kept and the first that is not."""
    ordered = sorted(float(distance) for distance in distances)
    kept = math.floor((1 - rejected) * len(ordered) + 0.5)
    if kept == 0:
        return ordered[0]
    if kept == len(ordered):
        return ordered[-1]
    return (ordered[kept - 1] + ordered[kept]) / 2


def histogram_distance(
    samples: np.ndarray, pixels: np.ndarray, bins: int, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """√(2 ln(peak/p)) from numpy.histogramdd."""
    counts, edges = np.histogramdd(samples, bins, list(zip(low, high, strict=True)))
    places = [
        np.clip(np.searchsorted(edge, column, "right") - 1, 0, bins - 1)
        for edge, column in zip(edges, pixels.T, strict=True)
    ]
    with np.errstate(divide="ignore"):
        return np.sqrt(2 * np.log(counts.max() / counts[tuple(places)]))


def gaussian_covariance(samples: np.ndarray, ridge: float, floor: np.ndarray) -> np.ndarray:
    """The regularised covariance of dd_tools, with a floor of variance."""
    covariance = np.atleast_2d(np.cov(samples.T, ddof=1))
    mean_variance = np.trace(covariance) / len(covariance)
    return (
        (1 - ridge) * covariance + ridge * mean_variance * np.eye(len(covariance)) + np.diag(floor)
    )


def mixture_log_density(
    points: np.ndarray, shares: np.ndarray, means: np.ndarray, covariances: np.ndarray
) -> np.ndarray:
    """ln Σ P_n N(x; μ_n, Σ_n) with SciPy's densities."""
    parts = [
        np.log(share) + multivariate_normal(mean, covariance).logpdf(points)
        for share, mean, covariance in zip(shares, means, covariances, strict=True)
    ]
    return log_sum(np.atleast_2d(parts))


def expectation_maximisation(
    samples: np.ndarray, memberships: np.ndarray, widening: np.ndarray, rounds: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shares, means and covariances after some rounds, one component at a time."""
    components = len(memberships)
    for number in range(rounds):
        shares = memberships.sum(1) / len(samples)
        means = np.stack([np.average(samples, 0, row) for row in memberships])
        covariances = np.stack(
            [
                np.atleast_2d(np.cov(samples.T, aweights=row, ddof=0)) + np.diag(widening)
                for row in memberships
            ]
        )
        if number < rounds - 1:
            parts = [
                np.log(shares[n]) + multivariate_normal(means[n], covariances[n]).logpdf(samples)
                for n in range(components)
            ]
            memberships = np.exp(parts - log_sum(np.stack(parts)))
    return shares, means, covariances


def least_radius(apart: np.ndarray, count: int) -> float:
    """The least largest distance to the nearest of ``count`` centres, over all choices."""
    return min(
        float(apart[list(centres)].min(0).max())
        for centres in combinations(range(len(apart)), count)
    )
