"""Whether trust, the expected F of a mask, tells good masks from bad ones: ranks and risk.

Everything is over single pictures, never over pixels. Only the order of trusts counts, and
equal ones are no order: what depends on it is the mean over all orders of equals.

Sources: Spearman, American Journal of Psychology 1904; Fawcett, An introduction to ROC
analysis, 2006; Geifman, Uziel, El-Yaniv, ICLR 2019 (the risk-coverage curve, its area, and
the ideal one beside it).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from roadtorch.evaluation.curves import Curve

BAD = 0.6  # F below which a mask is a failure; ours: where one looks wrong at first sight

FEWEST = 4  # pictures of a group that has a correlation of its own; ours


@dataclass(frozen=True)
class Trusted:
    """Pictures with a trust and an F of the own mask, float64 (n,) each; groups: whose they are."""

    trust: Tensor
    f: Tensor
    groups: Sequence[str]


def rank_correlation(one: Tensor, other: Tensor) -> float:
    """Spearman's: the correlation of the ranks of two (n,); NaN where either is constant."""
    ranks = torch.stack([average_ranks(one), average_ranks(other)])
    centred = ranks - ranks.mean(1, keepdim=True)
    lengths = centred.norm(dim=1)
    return float((centred[0] * centred[1]).sum() / lengths.prod())


def average_ranks(values: Tensor) -> Tensor:
    """Ranks 1…n of (n,), the smallest first, float64; equal values share the mean of theirs."""
    _, places, counts = values.unique(return_inverse=True, return_counts=True)
    last = counts.cumsum(0).to(torch.float64)
    return (last - (counts - 1) / 2)[places]


def correlation_within(pictures: Trusted, fewest: int = FEWEST) -> float:
    """The mean of the groups' own rank correlations; NaN without a group that has one."""
    found = []
    for group in sorted(set(pictures.groups)):
        own = torch.tensor([name == group for name in pictures.groups])
        if int(own.sum()) >= fewest:
            found.append(rank_correlation(pictures.trust[own], pictures.f[own]))
    return float(torch.tensor(found, dtype=torch.float64).nanmean())


def failure_auc(trust: Tensor, f: Tensor, bad: float = BAD) -> float:
    """Share of pairs (bad picture, good one) in which the bad one is trusted less.

    Equal trusts count half. The area under the ROC of "F < bad" by low trust; NaN where all
    are bad or none is.
    """
    failed = f < bad
    pairs = int(failed.sum()) * int((~failed).sum())
    # Mann and Whitney: the ranks of the good ones, less those that they have among themselves.
    good = int((~failed).sum())
    won = average_ranks(trust)[~failed].sum() - good * (good + 1) / 2
    return float(won / pairs) if pairs else float("nan")


def risk_coverage(trust: Tensor, f: Tensor) -> Curve:
    """Mean 1 - F (y) of the 1, 2, … n most trusted pictures, by their share of all (x): (n,)."""
    _, places, counts = trust.unique(return_inverse=True, return_counts=True)
    loss = 1 - f.to(torch.float64)
    of_equals = torch.zeros(len(counts), dtype=torch.float64).index_add_(0, places, loss) / counts
    kept = torch.arange(1, len(trust) + 1, dtype=torch.float64)
    risk = of_equals.flip(0).repeat_interleave(counts.flip(0)).cumsum(0) / kept
    return Curve(kept / len(trust), risk)


def ideal_risk_coverage(f: Tensor) -> Curve:
    """The same for a trust that orders the pictures as their F does: no curve is below it."""
    return risk_coverage(f, f)


def risk_area(curve: Curve) -> float:
    """AURC: the mean risk over all numbers of pictures kept; NaN without pictures."""
    return float(curve.y.mean())
