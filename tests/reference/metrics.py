"""Measures computed the slow, obvious way, from pixels, in NumPy."""

import numpy as np


def count_levels(
    scores: np.ndarray, road: np.ndarray, valid: np.ndarray, levels: int
) -> tuple[np.ndarray, np.ndarray]:
    """Pixel by pixel: each goes to the level it lies nearest to, the upper one of two."""
    counts = np.zeros((2, levels), np.int64)
    for score, true, counted in zip(scores.flat, road.flat, valid.flat, strict=True):
        if counted:
            counts[int(true), int(np.floor(float(score) * (levels - 1) + 0.5))] += 1
    return counts[1], counts[0]


def auc(scores: np.ndarray, road: np.ndarray) -> float:
    """Count the pairs (road, background) in the right order, ties one half."""
    above = ties = 0
    for positive in scores[road]:
        above += int((positive > scores[~road]).sum())
        ties += int((positive == scores[~road]).sum())
    return (above + ties / 2) / (road.sum() * (~road).sum())


def max_f(scores: np.ndarray, road: np.ndarray, thresholds: np.ndarray) -> tuple[float, float]:
    """Try every threshold, lowest first; keep the first best F."""
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
    """For each of eleven recalls, the best precision of the thresholds that reach it."""
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


def iou(mask: np.ndarray, road: np.ndarray, valid: np.ndarray) -> float:
    """Pixel by pixel."""
    both = either = 0
    for decided, true, counts in zip(mask.flat, road.flat, valid.flat, strict=True):
        if counts:
            both += int(decided and true)
            either += int(decided or true)
    return both / either


def confusion(labels: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Pixel by pixel; 255 becomes row or column 3."""
    table = np.zeros((4, 4), np.int64)
    for label, true in zip(labels.flat, truth.flat, strict=True):
        table[min(int(true), 3), min(int(label), 3)] += 1
    return table
