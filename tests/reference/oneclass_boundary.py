"""Boundary classifiers of P3, slow and simple, in NumPy's double precision."""

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

Array = NDArray[np.floating[Any]]


def distance_matrix(first: Array, second: Array) -> Array:
    """Return |a - b| for rows a of ``first``, b of ``second``."""
    return np.sqrt(((first[:, None] - second[None]) ** 2).sum(2))


def nearest_distance(samples: Array, pixels: Array) -> Array:
    return distance_matrix(pixels, samples).min(1)


def segment_distance(pixel: Array, start: Array, end: Array) -> float:
    """Return the distance to the foot of the perpendicular, or to the nearer end."""
    step = end - start
    length = float(step @ step)
    share = float((pixel - start) @ step) / length if length else 0.0
    if share <= 0:
        return float(np.linalg.norm(pixel - start))
    if share >= 1:
        return float(np.linalg.norm(pixel - end))
    return float(np.linalg.norm(pixel - start - share * step))


def tree_distance(samples: Array, pixels: Array) -> Array:
    samples = np.unique(samples, axis=0)
    edges = kruskal(samples)
    return np.array(
        [min(segment_distance(x, samples[i], samples[j]) for i, j in edges) for x in pixels]
    )


def kruskal(samples: Array) -> list[tuple[int, int]]:
    """Return the shortest edges that close no cycle."""
    length = distance_matrix(samples, samples)
    group = list(range(len(samples)))
    edges = []
    for i, j in sorted(combinations(range(len(samples)), 2), key=lambda edge: length[edge]):
        if group[i] != group[j]:
            edges.append((i, j))
            joined = group[j]
            group = [group[i] if g == joined else g for g in group]
    return edges


def kernel(first: Array, second: Array, sigma: float) -> Array:
    return np.exp(-(distance_matrix(first, second) ** 2) / sigma**2)


def ball_distance(samples: Array, weights: Array, sigma: float, pixels: Array) -> Array:
    norm = weights @ kernel(samples, samples, sigma) @ weights
    return np.sqrt(np.maximum(1 + norm - 2 * kernel(pixels, samples, sigma) @ weights, 0))


def minimax_score(samples: Array, pixels: Array, ridge: float, sigma: float) -> Array:
    """Follow the toolbox's steps over all samples, duplicates included; scaled to mean 1."""
    gram = kernel(samples, samples, sigma)
    mean = gram.mean(0)
    rows = (gram - mean) / np.sqrt(len(samples))
    solved = np.linalg.solve(rows.T @ rows + ridge * np.eye(len(samples)), mean)
    return kernel(pixels, samples, sigma) @ solved / (mean @ solved)


def game_value(dissimilarities: Array, cap: float) -> float:
    """Solve the dual of dLP: the worst mixture p of samples, p ≤ cap, against their best response.

    Any p guarantees a lower bound of dLP's value, which is checked here.
    """
    number = len(dissimilarities)
    solution = linprog(
        np.r_[np.zeros(number), -1.0],
        A_ub=np.c_[-dissimilarities.T, np.ones(number)],
        b_ub=np.zeros(number),
        A_eq=np.r_[np.ones(number), 0.0][None],
        b_eq=[1.0],
        bounds=[(0, cap)] * number + [(None, None)],
    )
    worst = np.clip(solution.x[:number], 0, cap)
    worst = worst / worst.sum()
    assert worst.max() <= cap * (1 + 1e-9)
    return float((worst @ dissimilarities).min())
