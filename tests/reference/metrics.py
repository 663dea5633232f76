"""Measures computed slowly and simply, from pixels, in NumPy."""

import numpy as np


def count_levels(
    scores: np.ndarray, road: np.ndarray, valid: np.ndarray, levels: int
) -> tuple[np.ndarray, np.ndarray]:
    """Count pixel by pixel: each belongs to the nearest level, the upper one of two."""
    counts = np.zeros((2, levels), np.int64)
    for score, true, counted in zip(scores.flat, road.flat, valid.flat, strict=True):
        if counted:
            counts[int(true), int(np.floor(float(score) * (levels - 1) + 0.5))] += 1
    return counts[1], counts[0]


def max_f(scores: np.ndarray, road: np.ndarray, thresholds: np.ndarray) -> tuple[float, float]:
    """Try every threshold, lowest first; return the first best F."""
    best, where = -1.0, float("nan")
    for threshold in thresholds:
        mask = scores >= threshold
        hits = int((mask & road).sum())
        precision = hits / (mask.sum() + 1e-10)
        recall = hits / road.sum()
        value = 2 * precision * recall / (precision + recall + 1e-10)
        if value > best:
            best, where = value, float(threshold)
    return best, where


def average_precision(scores: np.ndarray, road: np.ndarray, thresholds: np.ndarray) -> float:
    """Average the best precision at each of eleven recalls."""
    points = []
    for threshold in thresholds:
        mask = scores >= threshold
        hits = int((mask & road).sum())
        points.append((hits / (mask.sum() + 1e-10), hits / road.sum()))
    total, step = 0.0, 0.0
    for number in range(11):
        step = number * 0.1
        total += max(precision for precision, recall in points if recall >= step)
    return total / 11
