"""ROC curves and their averages, slow and simple, from pixels, in NumPy."""

import numpy as np

Points = list[tuple[float, float]]


def roc(scores: np.ndarray, road: np.ndarray) -> Points:
    """Lower the threshold through the distinct scores; count anew each time."""
    points = [(0.0, 0.0)]
    for threshold in sorted(set(scores.ravel().tolist()), reverse=True):
        points.append(rates(scores, road, threshold))
    return points


def rates(scores: np.ndarray, road: np.ndarray, threshold: float) -> tuple[float, float]:
    """Return the false and true positive rate of "score ≥ threshold"."""
    mask = scores >= threshold
    return float((mask & ~road).sum() / (~road).sum()), float((mask & road).sum() / road.sum())


def height(points: Points, x: float) -> float:
    """Return the curve above x: the last point not right of x, then along the next segment."""
    k = max(index for index, point in enumerate(points) if point[0] <= x)
    if points[k][0] == x:
        return points[k][1]
    (start, low), (end, high) = points[k], points[k + 1]
    return low + (high - low) * (x - start) / (end - start)
