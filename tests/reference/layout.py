"""Ordered columns by trying every path, one column and one segment at a time."""

from itertools import product

import numpy as np


def chain_posterior(evidence: np.ndarray, move: np.ndarray) -> np.ndarray:
    """Return the posterior of a Markov chain with evidence (R, K): the sum over all Kᴿ paths.

    All classes are equally likely at the top; ``move`` (K, K) has the transition probabilities.
    """
    rows, classes = evidence.shape
    posterior = np.zeros((rows, classes))
    for path in product(range(classes), repeat=rows):
        weight = evidence[0, path[0]]
        for row in range(1, rows):
            weight *= move[path[row - 1], path[row]] * evidence[row, path[row]]
        for row in range(rows):
            posterior[row, path[row]] += weight
    return posterior / posterior.sum(1, keepdims=True)


def transitions(change: float, breach: float) -> np.ndarray:
    """Return probabilities (3, 3) of a step down: stay, next class, or anything else."""
    return np.array(
        [
            [1 - change - breach, change, breach],
            [breach, 1 - change - breach, change],
            [breach, breach, 1 - 2 * breach],
        ]
    )


def smooth_columns(
    scores: np.ndarray, labels: np.ndarray, weight: float, step: int, move: np.ndarray
) -> np.ndarray:
    """Return beliefs (n, 3): mean posteriors of each segment's samples, or its scores."""
    local = np.exp(weight * (scores - scores.max(1, keepdims=True)))
    local = np.maximum(local / local.sum(1, keepdims=True), 1e-4)
    samples: list[list[np.ndarray]] = [[] for _ in scores]
    for column in range(step // 2, labels.shape[1], step):
        numbers = [labels[row, column] for row in range(step // 2, labels.shape[0], step)]
        for number, row in zip(numbers, chain_posterior(local[numbers], move), strict=True):
            samples[number].append(row)
    return np.stack(
        [
            np.mean(rows, axis=0) if rows else score / score.sum()
            for rows, score in zip(samples, local, strict=True)
        ]
    )
