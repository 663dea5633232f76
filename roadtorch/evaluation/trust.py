"""Whether trust, the expected F of a mask, tells good masks from bad ones: ranks and risk.

Everything is over single images, never over pixels. Only the order of trusts counts, and
equal ones are no order: what depends on it is the mean over all orders of equals.

Sources: Spearman, American Journal of Psychology 1904; Fawcett, An introduction to ROC
analysis, 2006; Geifman, Uziel, El-Yaniv, ICLR 2019 (the risk-coverage curve, its area, and
the ideal one beside it).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from roadtorch.evaluation.curves import Curve
from roadtorch.evaluation.measure import Measure, Place
from roadtorch.evaluation.metrics import f_measure
from roadtorch.evaluation.tally import Images, Part

BAD = 0.6  # F below which a mask is a failure; ours: where one looks wrong at first sight

MIN_IMAGES = 4  # images of a group that has a correlation of its own; ours


@dataclass(frozen=True)
class Trusted:
    """Images with a trust and an F of the own mask, float64 (n,) each; groups: whose they are."""

    trust: Tensor
    f: Tensor
    groups: Sequence[str]


def trusted(images: Images | None) -> Trusted | None:
    """The images that have a trust and an F of the mask; None where no image has a trust."""
    if images is None or images.trust.isnan().all():
        return None
    f = f_measure(images.mask)
    known = ~(images.trust.isnan() | f.isnan())
    groups = [group for group, kept in zip(images.groups, known.tolist(), strict=True) if kept]
    return Trusted(images.trust[known], f[known], groups)


def rank_correlation(first: Tensor, second: Tensor) -> float:
    """Spearman's: the correlation of the ranks of two (n,); NaN where either is constant."""
    ranks = torch.stack([average_ranks(first), average_ranks(second)])
    centred = ranks - ranks.mean(1, keepdim=True)
    lengths = centred.norm(dim=1)
    return float((centred[0] * centred[1]).sum() / lengths.prod())


def average_ranks(values: Tensor) -> Tensor:
    """Ranks 1…n of (n,), the smallest first, float64; equal values share the mean of theirs."""
    _, places, counts = values.unique(return_inverse=True, return_counts=True)
    last = counts.cumsum(0).to(torch.float64)
    return (last - (counts - 1) / 2)[places]


def correlation_within(images: Trusted) -> float:
    """The mean of the groups' own rank correlations; NaN without a group that has one."""
    correlations = []
    for group in sorted(set(images.groups)):
        own = torch.tensor([name == group for name in images.groups])
        if int(own.sum()) >= MIN_IMAGES:
            correlations.append(rank_correlation(images.trust[own], images.f[own]))
    return float(torch.tensor(correlations, dtype=torch.float64).nanmean())


def failure_auc(trust: Tensor, f: Tensor, bad: float = BAD) -> float:
    """Share of pairs (bad image, good one) in which the bad one is trusted less.

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
    """Mean 1 - F (y) of the 1, 2, … n most trusted images, by their share of all (x): (n,).

    Ideal is the curve of a trust that orders the images as their F does: none is below it.
    """
    _, places, counts = trust.unique(return_inverse=True, return_counts=True)
    loss = 1 - f.to(torch.float64)
    of_equals = torch.zeros(len(counts), dtype=torch.float64).index_add_(0, places, loss) / counts
    kept = torch.arange(1, len(trust) + 1, dtype=torch.float64)
    risk = of_equals.flip(0).repeat_interleave(counts.flip(0)).cumsum(0) / kept
    return Curve(kept / len(trust), risk)


def risk_area(curve: Curve) -> float:
    """AURC: the mean risk over all numbers of images kept; NaN without images."""
    return float(curve.y.mean())


# --- the measures: of single images, so that what stands above groups is of them all ------


def _measure(
    key: str,
    name: str,
    meaning: str,
    figure: Callable[[Trusted], float],
    better: Literal["higher", "lower"] | None = "higher",
    shown: tuple[Place, ...] = ("trust",),
) -> Measure:
    """A figure of the images that have a trust; none where no image has."""

    def formula(part: Part) -> float | None:
        images = trusted(part.images)
        return None if images is None else figure(images)

    key = f"trust/{key}"
    return Measure(key, name, meaning, formula, better, over_groups="whole", shown=shown)


TRUST = (
    _measure(
        "rank_correlation",
        "rank corr. of trust",
        "Spearman's correlation of trust with the image's F of the mask, over all images.",
        lambda images: rank_correlation(images.trust, images.f),
        shown=("trust", "parts"),
    ),
    _measure(
        "rank_correlation_within",
        "within groups",
        f"Mean of the groups' own such correlations; those with {MIN_IMAGES} images or more.",
        correlation_within,
    ),
    _measure(
        "auc",
        f"AUC for F < {BAD:g}",
        f"Share of pairs (an image with F < {BAD:g}, another one) in which the first is "
        "trusted less.",
        lambda images: failure_auc(images.trust, images.f),
    ),
    _measure(
        "error",
        "mean error",
        "Mean distance of trust and the image's F of the mask.",
        lambda images: float((images.trust - images.f).abs().mean()),
        "lower",
    ),
    _measure(
        "aurc",
        "AURC",
        "Mean of 1 - F over the images kept, averaged over all numbers of them, the most "
        "trusted first.",
        lambda images: risk_area(risk_coverage(images.trust, images.f)),
        "lower",
    ),
    _measure(
        "aurc_ideal",
        "AURC, ideal",
        "The same if trust had the order of F.",
        lambda images: risk_area(risk_coverage(images.f, images.f)),
        None,
    ),
    _measure(
        "aurc_random",
        "AURC, random",
        "The same if trust had no order: the mean of 1 - F.",
        lambda images: float((1 - images.f).mean()),
        None,
    ),
)
