"""Risk of trusting, slow and simple: order by order."""

from itertools import pairwise, permutations


def risks(trust: list[float], f: list[float]) -> list[float]:
    """Mean 1 - F of the first 1, 2, … images, over all orders that put no trust before more."""
    risks = []
    for order in permutations(range(len(trust))):
        if all(trust[a] >= trust[b] for a, b in pairwise(order)):
            losses = [1 - f[place] for place in order]
            risks.append([sum(losses[:k]) / k for k in range(1, len(losses) + 1)])
    return [sum(column) / len(risks) for column in zip(*risks, strict=True)]
