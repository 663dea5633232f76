"""Texture measures by their definitions, one region and one pixel at a time."""

import numpy as np


def uniformity_of_values(levels: np.ndarray) -> float:
    """Σ p² over the levels that occur (P2 eq. 1)."""
    return sum(float(np.mean(levels == level)) ** 2 for level in set(levels.tolist()))


def minimum_variance_weights(samples: np.ndarray, ridge: float) -> np.ndarray:
    """P2 eq. 3 with an explicit inverse and a ridge in mean variances; samples (K,N)."""
    covariance = np.cov(samples.T, bias=True)
    added = ridge * np.trace(covariance) / len(covariance)
    inverse = np.linalg.inv(covariance + added * np.eye(len(covariance)))
    ones = np.ones(samples.shape[1])
    return inverse @ ones / (ones @ inverse @ ones)


def chi_square(first: np.ndarray, second: np.ndarray) -> float:
    """Σ (p-q)²/(p+q) over the levels that occur in either."""
    p, q = first / first.sum(), second / second.sum()
    return sum((a - b) ** 2 / (a + b) for a, b in zip(p, q, strict=True) if a + b > 0)


def fused(planes: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """P2 eq. 2, pixel by pixel; planes (N,H,W)."""
    result = np.zeros(planes.shape[1:])
    for row, column in np.ndindex(*result.shape):
        for plane, weight in zip(planes, weights, strict=True):
            result[row, column] += weight * plane[row, column]
    return result
