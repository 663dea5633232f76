"""Otsu's threshold, slow and simple: every cut, both classes measured."""

import numpy as np


def between_classes(values: np.ndarray, threshold: float) -> float:
    """Return the variance between values below a threshold and above; 0 for a single class."""
    below, above = values[values < threshold], values[values >= threshold]
    if not len(below) or not len(above):
        return 0.0
    weight = len(below) / len(values)
    return float(weight * (1 - weight) * (below.mean() - above.mean()) ** 2)


def binned(values: np.ndarray, bins: int) -> np.ndarray:
    """Move each value to the middle of its bin."""
    edges = np.linspace(values.min(), values.max(), bins + 1)
    places = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, bins - 1)
    return (edges[places] + edges[places + 1]) / 2


def most_between(values: np.ndarray) -> float:
    """Return the largest variance between classes of any threshold."""
    return max(between_classes(values, threshold) for threshold in np.unique(values))
