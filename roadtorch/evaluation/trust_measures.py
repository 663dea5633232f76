"""Measures of trust, the predicted F of a mask: rank correlation, failure detection.

All are over single images, never over pixels. Only the order of trusts counts; where equal trusts
have no order, the result is the mean over all of their orders.

Sources: Spearman, American Journal of Psychology 1904; Fawcett, An introduction to ROC
analysis, 2006.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from roadtorch.evaluation.measure import Measure, TableName
from roadtorch.evaluation.metrics import f_measure
from roadtorch.evaluation.tally import ImageTable, PooledCounts

FAILURE_F = 0.6  # F below which a mask is a failure; ours: such masks look wrong at first sight
MIN_GROUP_IMAGES = 4  # images that a group needs for a correlation; ours


@dataclass(frozen=True, eq=False)
class TrustSamples:
    """Images with a trust and an F of the mask, float64 (n,) each, and the group of each image."""

    trust: Tensor
    f: Tensor
    groups: Sequence[str]


def trust_samples(images: ImageTable | None) -> TrustSamples | None:
    """Return the images that have a trust and an F of the mask; None where no image has a trust."""
    if images is None or images.trust.isnan().all():
        return None
    f = f_measure(images.mask)
    defined = ~(images.trust.isnan() | f.isnan())
    groups = [images.groups[int(i)] for i in defined.nonzero()]
    return TrustSamples(images.trust[defined], f[defined], groups)


def rank_correlation(first: Tensor, second: Tensor) -> float:
    """Compute Spearman's rank correlation of two (n,); NaN where either is constant."""
    ranks = torch.stack([average_ranks(first), average_ranks(second)])
    centred = ranks - ranks.mean(1, keepdim=True)
    return float((centred[0] * centred[1]).sum() / centred.norm(dim=1).prod())


def average_ranks(values: Tensor) -> Tensor:
    """Return ranks 1…n of (n,), the smallest first, float64; equal values get their mean rank."""
    _, indices, counts = values.unique(return_inverse=True, return_counts=True)
    last = counts.cumsum(0).to(torch.float64)
    return (last - (counts - 1) / 2)[indices]


def mean_group_correlation(samples: TrustSamples) -> float:
    """Return the mean of the groups' rank correlations; NaN without a group that has one."""
    correlations = []
    for group in sorted(set(samples.groups)):
        members = torch.tensor([name == group for name in samples.groups])
        if int(members.sum()) >= MIN_GROUP_IMAGES:
            correlations.append(rank_correlation(samples.trust[members], samples.f[members]))
    return float(torch.tensor(correlations, dtype=torch.float64).nanmean())


def failure_auc(trust: Tensor, f: Tensor) -> float:
    """Compute the area under the ROC of detecting F < ``FAILURE_F`` by low trust.

    It is the fraction of pairs (bad image, good image) in which the bad one has the lower trust;
    equal trusts count half. NaN where all are bad or none is.
    """
    failed = f < FAILURE_F
    pairs = int(failed.sum()) * int((~failed).sum())
    # Mann-Whitney U: the ranks of the good images, less their ranks among themselves.
    good = int((~failed).sum())
    won = average_ranks(trust)[~failed].sum() - good * (good + 1) / 2
    return float(won / pairs) if pairs else float("nan")


# --- measures over single images: the headline is that of all images ------------------------


def _measure(
    key: str,
    name: str,
    meaning: str,
    function: Callable[[TrustSamples], float],
    better: Literal["higher", "lower"] | None = "higher",
    tables: tuple[TableName, ...] = ("trust",),
) -> Measure:
    """Return a measure over the images that have a trust; it does not apply where none has."""

    def formula(part: PooledCounts) -> float | None:
        samples = trust_samples(part.images)
        return None if samples is None else function(samples)

    key = f"trust/{key}"
    return Measure(key, name, meaning, formula, better, aggregate="whole", tables=tables)


TRUST_MEASURES = (
    _measure(
        "rank_correlation",
        "rank corr. of trust",
        "Spearman's rank correlation of trust with the F of the image's mask, over all images.",
        lambda samples: rank_correlation(samples.trust, samples.f),
        tables=("trust", "parts"),
    ),
    _measure(
        "rank_correlation_within",
        "within groups",
        f"Mean of the rank correlations of groups with {MIN_GROUP_IMAGES} images or more.",
        mean_group_correlation,
    ),
    _measure(
        "auc",
        f"AUC for F < {FAILURE_F:g}",
        f"Fraction of pairs (an image with F < {FAILURE_F:g}, another one) in which the first "
        "has the lower trust.",
        lambda samples: failure_auc(samples.trust, samples.f),
    ),
    _measure(
        "error",
        "mean error",
        "Mean difference of trust and the F of the image's mask.",
        lambda samples: float((samples.trust - samples.f).abs().mean()),
        "lower",
    ),
)
