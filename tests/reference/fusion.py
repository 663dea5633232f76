"""Naive Bayes by the product formula, and the road of an image one segment at a time."""

import math
from collections.abc import Sequence


def kept(likelihood: float) -> float:
    """Return a likelihood clipped to 10⁻⁴ from 0 and 1."""
    return min(max(likelihood, 1e-4), 1 - 1e-4)


def naive_bayes(prior: float, likelihoods: Sequence[float], weights: Sequence[float]) -> float:
    """Return p(R)·ΠLᵂ over its sum with the background's product; P2 eq. 4 lacks the second."""
    road, background = kept(prior), 1 - kept(prior)
    for likelihood, weight in zip(likelihoods, weights, strict=True):
        road *= kept(likelihood) ** weight
        background *= (1 - kept(likelihood)) ** weight
    return road / (road + background)


def log_odds(likelihood: float) -> float:
    """Return log(L / (1-L)) of a likelihood clipped off 0 and 1."""
    return math.log(kept(likelihood) / (1 - kept(likelihood)))


def neighbours(pairs: list[tuple[int, int]], count: int) -> list[list[int]]:
    """Return the segments that share a border with each of ``count`` segments."""
    return [
        [second for first, second in pairs if first == number]
        + [first for first, second in pairs if second == number]
        for number in range(count)
    ]


def learned_scores(
    prior: list[float],
    alike: list[list[float]],
    size: list[float],
    around: list[list[int]],
    look: tuple[float, float],
    neighbour: float,
    rounds: int,
) -> list[float]:
    """Return log odds of road after rounds of learning the appearance of road and background.

    ``look`` is its weight, and its largest log ratio before the weight.
    """
    weight, most = look
    scores = prior
    for _ in range(rounds):
        belief = [1 / (1 + math.exp(-score)) for score in scores]
        scores = [
            prior[number]
            + weight * min(max(_log_ratio(alike[number], belief, size), -most), most)
            + neighbour * _mean([2 * belief[near] - 1 for near in around[number]])
            for number in range(len(prior))
        ]
    return scores


def _log_ratio(alike: list[float], belief: list[float], size: list[float]) -> float:
    """Return log p(segment | road) - log p(segment | background) by kernel density."""
    logs = []
    for members in (belief, [1 - value for value in belief]):
        support = [member * share for member, share in zip(members, size, strict=True)]
        near = sum(like * weight for like, weight in zip(alike, support, strict=True))
        logs.append(math.log(max(near / max(sum(support), 1e-3), 1e-8)))
    return logs[0] - logs[1]


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else 0.0
