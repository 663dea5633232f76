"""Naive Bayes by the product formula, and the road of an image one segment at a time."""

import math
from collections.abc import Sequence


def kept(likelihood: float) -> float:
    """A likelihood at least 10⁻⁴ from 0 and 1."""
    return min(max(likelihood, 1e-4), 1 - 1e-4)


def naive_bayes(prior: float, likelihoods: Sequence[float], weights: Sequence[float]) -> float:
    """p(R)·ΠLᵂ over its sum with the same product for the background; P2 eq. 4 has no second."""
    road, background = kept(prior), 1 - kept(prior)
    for likelihood, weight in zip(likelihoods, weights, strict=True):
        road *= kept(likelihood) ** weight
        background *= (1 - kept(likelihood)) ** weight
    return road / (road + background)


def log_odds(likelihood: float) -> float:
    """log(L / (1-L)) of a likelihood that is kept off 0 and 1."""
    return math.log(kept(likelihood) / (1 - kept(likelihood)))


def neighbours(pairs: list[tuple[int, int]], count: int) -> list[list[int]]:
    """For each of ``count`` segments those that share a border with it."""
    return [
        [two for one, two in pairs if one == number] + [one for one, two in pairs if two == number]
        for number in range(count)
    ]


def learned_scores(
    known: list[float],
    alike: list[list[float]],
    size: list[float],
    around: list[list[int]],
    look: tuple[float, float],
    neighbour: float,
    rounds: int,
) -> list[float]:
    """Log odds of road after rounds of learning what road and background look like.

    look: its weight, and the most it may say before it is weighted.
    """
    weight, most = look
    scores = known
    for _ in range(rounds):
        belief = [1 / (1 + math.exp(-score)) for score in scores]
        scores = [
            known[number]
            + weight * min(max(_log_ratio(alike[number], belief, size), -most), most)
            + neighbour * _mean([2 * belief[other] - 1 for other in around[number]])
            for number in range(len(known))
        ]
    return scores


def _log_ratio(alike: list[float], belief: list[float], size: list[float]) -> float:
    """log p(segment | road) - log p(segment | background) by kernel density."""
    logs = []
    for members in (belief, [1 - value for value in belief]):
        support = [member * share for member, share in zip(members, size, strict=True)]
        near = sum(like * weight for like, weight in zip(alike, support, strict=True))
        logs.append(math.log(max(near / max(sum(support), 1e-3), 1e-8)))
    return logs[0] - logs[1]


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else 0.0
