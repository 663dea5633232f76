"""Orderly columns by trying every path, one column and one segment at a time."""

from itertools import product

import numpy as np


def chain_posterior(evidence: np.ndarray, move: np.ndarray) -> np.ndarray:
    """Posterior (R,K) of a hidden Markov chain with evidence (R,K): the sum over all Kᴿ paths.

    Every class is as likely at the top; ``move`` (K,K) holds the chances of going from row to
    column.
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
    """Chances (3,3) of a step down: stay, go on to the next class, or anything else."""
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
    """Beliefs (n,3): posteriors of the samples of each segment, averaged; scores where none."""
    local = np.exp(weight * (scores - scores.max(1, keepdims=True)))
    local = np.maximum(local / local.sum(1, keepdims=True), 1e-4)
    samples: list[list[np.ndarray]] = [[] for _ in scores]
    for column in range(step // 2, labels.shape[1], step):
        numbers = [labels[row, column] for row in range(step // 2, labels.shape[0], step)]
        for number, row in zip(numbers, chain_posterior(local[numbers], move), strict=True):
            samples[number].append(row)
    return np.stack(
        [
            np.mean(found, axis=0) if found else own / own.sum()
            for found, own in zip(samples, local, strict=True)
        ]
    )
