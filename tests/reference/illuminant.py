"""Entropy of a projection of log chromaticities, value by value (Finlayson et al. 2004)."""

import math

import numpy as np


def entropy(points: np.ndarray, angle: float) -> float:
    """Return the entropy in bits of points (2, n) projected to a direction in degrees."""
    radians = math.radians(angle)
    values = sorted(points[0] * math.cos(radians) + points[1] * math.sin(radians))
    low, high = np.quantile(values, 0.05), np.quantile(values, 0.95)
    middle = [value for value in values if low <= value <= high]
    width = 3.5 * float(np.std(middle)) / len(middle) ** (1 / 3)
    counts: dict[int, int] = {}
    for value in middle:
        index = math.floor((value - low) / width)
        counts[index] = counts.get(index, 0) + 1
    return -sum(count / len(middle) * math.log2(count / len(middle)) for count in counts.values())
