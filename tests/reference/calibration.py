"""Calibration the slow, obvious way, from pixels."""

import numpy as np


def brier(scores: np.ndarray, road: np.ndarray) -> float:
    """Pixel by pixel."""
    pairs = zip(scores.flat, road.flat, strict=True)
    return sum((float(score) - float(true)) ** 2 for score, true in pairs) / scores.size


def reliability(
    scores: np.ndarray, road: np.ndarray, bins: int
) -> list[tuple[float, float, float]]:
    """For every bin (low, high], the first with its 0: mean score, share of road, of pixels."""
    rows = []
    for number in range(bins):
        low, high = number / bins, (number + 1) / bins
        inside = (scores > low) & (scores <= high)
        if number == 0:
            inside |= scores == 0
        count = inside.sum()
        mean = scores[inside].mean() if count else np.nan
        rows.append((mean, road[inside].mean() if count else np.nan, count / scores.size))
    return rows
