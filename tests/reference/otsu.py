"""Otsu's threshold the slow, obvious way: every cut, both classes measured."""

import numpy as np


def between_classes(values: np.ndarray, threshold: float) -> float:
    """Variance between the values below a threshold and the others; 0 for a single class."""
    below, above = values[values < threshold], values[values >= threshold]
    if not len(below) or not len(above):
        return 0.0
    weight = len(below) / len(values)
    return float(weight * (1 - weight) * (below.mean() - above.mean()) ** 2)


def binned(values: np.ndarray, bins: int) -> np.ndarray:
    """Each value moved to the middle of its bin."""
    edges = np.linspace(values.min(), values.max(), bins + 1)
    places = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, bins - 1)
    return (edges[places] + edges[places + 1]) / 2


def most_between(values: np.ndarray) -> float:
    """The largest variance between classes that any threshold gives."""
    return max(between_classes(values, threshold) for threshold in np.unique(values))
