"""Measures of trust the slow, obvious way: pair by pair, order by order."""

import math
from itertools import pairwise, permutations


def ranks(values: list[float]) -> list[float]:
    """One more than the smaller ones, and half of the equal ones."""
    return [
        1 + sum(other < one for other in values) + (sum(other == one for other in values) - 1) / 2
        for one in values
    ]


def rank_correlation(one: list[float], other: list[float]) -> float:
    """Pearson's correlation of the ranks."""
    x, y = ranks(one), ranks(other)
    mean_x, mean_y = sum(x) / len(x), sum(y) / len(y)
    both = sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True))
    spread = sum((a - mean_x) ** 2 for a in x) * sum((b - mean_y) ** 2 for b in y)
    return both / math.sqrt(spread) if spread else math.nan


def failure_auc(trust: list[float], f: list[float], bad: float) -> float:
    """Every pair of a bad and a good picture."""
    pairs = [
        (one, other)
        for one, f_one in zip(trust, f, strict=True)
        for other, f_other in zip(trust, f, strict=True)
        if f_one < bad <= f_other
    ]
    won = sum(1.0 if low < high else 0.5 if low == high else 0.0 for low, high in pairs)
    return won / len(pairs) if pairs else math.nan


def risks(trust: list[float], f: list[float]) -> list[float]:
    """Mean 1 - F of the first 1, 2, … pictures, over all orders that put no trust before more."""
    found = []
    for order in permutations(range(len(trust))):
        if all(trust[a] >= trust[b] for a, b in pairwise(order)):
            losses = [1 - f[place] for place in order]
            found.append([sum(losses[:k]) / k for k in range(1, len(losses) + 1)])
    return [sum(column) / len(found) for column in zip(*found, strict=True)]
