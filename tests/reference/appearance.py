"""Appearance of the road in one image, pixel by pixel: Fisher's discriminant, and the fusion."""

import numpy as np


def discriminant(features: np.ndarray, log_odds: np.ndarray, ridge: float) -> np.ndarray:
    """Return log odds (N,) by the linear discriminant of features (C, N)."""
    count, pixels = features.shape
    standard = np.empty_like(features)
    for row in range(count):
        standard[row] = (features[row] - features[row].mean()) / (features[row].std() + 1e-6)
    belief = [2 / (1 + np.exp(-value)) - 1 for value in log_odds]
    means, covariances = [], []
    for sign in (1, -1):
        weights = [max(0.0, sign * value) for value in belief]
        total = sum(weights)
        mean = sum(weights[i] * standard[:, i] for i in range(pixels)) / total
        covariance = np.zeros((count, count))
        for i in range(pixels):
            offset = standard[:, i] - mean
            covariance += weights[i] * np.outer(offset, offset) / total
        means.append(mean)
        covariances.append(covariance)
    scatter = (covariances[0] + covariances[1]) / 2
    scatter += ridge * np.trace(scatter) / count * np.eye(count)
    direction = np.linalg.solve(scatter, means[0] - means[1])
    middle = (means[0] + means[1]) / 2
    scores = np.array([direction @ (standard[:, i] - middle) for i in range(pixels)])
    return scores * log_odds.std(ddof=1) / (scores.std(ddof=1) + 1e-6)


def average(log_odds: np.ndarray, appearance: np.ndarray, weight: float, most: float) -> np.ndarray:
    """Return the average of both log odds (N,), weighted by the mean doubt."""
    sureness = [abs(2 / (1 + np.exp(-value)) - 1) for value in log_odds]
    alpha = min(most, weight * (1 - sum(sureness) / len(sureness)))
    return np.array(
        [(1 - alpha) * a + alpha * b for a, b in zip(log_odds, appearance, strict=True)]
    )
