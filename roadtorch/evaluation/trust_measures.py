"""The measures of trust: of single pictures, so that what stands above drives is of them all."""

from collections.abc import Callable
from typing import Literal

from roadtorch.evaluation import trust
from roadtorch.evaluation.measure import Measure, Place
from roadtorch.evaluation.trust import Trusted


def _measure(
    key: str,
    name: str,
    meaning: str,
    figure: Callable[[Trusted], float],
    better: Literal["higher", "lower"] | None = "higher",
    shown: tuple[Place, ...] = ("trust",),
) -> Measure:
    """A figure of the pictures that have a trust; none where no picture has."""
    return Measure(
        f"trust/{key}",
        name,
        meaning,
        lambda part: None if part.trusted is None else figure(part.trusted),
        better,
        over_drives="whole",
        shown=shown,
    )


TRUST = (
    _measure(
        "rank_correlation",
        "rank corr.\nof trust",
        "Spearman's correlation of trust with the picture's F of the mask, over all pictures.",
        lambda pictures: trust.rank_correlation(pictures.trust, pictures.f),
        shown=("trust", "parts"),
    ),
    _measure(
        "rank_correlation_within",
        "within\ndrives",
        f"Mean of the drives' own such correlations; those with {trust.FEWEST} pictures or more.",
        trust.correlation_within,
    ),
    _measure(
        "auc",
        f"AUC for\nF < {trust.BAD:g}",
        f"Share of pairs (a picture with F < {trust.BAD:g}, another one) in which the first is "
        "trusted less.",
        lambda pictures: trust.failure_auc(pictures.trust, pictures.f),
    ),
    _measure(
        "error",
        "mean\nerror",
        "Mean distance of trust and the picture's F of the mask.",
        lambda pictures: float((pictures.trust - pictures.f).abs().mean()),
        "lower",
    ),
    _measure(
        "aurc",
        "AURC",
        "Mean of 1 - F over the pictures kept, averaged over all numbers of them, the most "
        "trusted first.",
        lambda pictures: trust.risk_area(trust.risk_coverage(pictures.trust, pictures.f)),
        "lower",
    ),
    _measure(
        "aurc_ideal",
        "AURC,\nideal",
        "The same if trust had the order of F.",
        lambda pictures: trust.risk_area(trust.ideal_risk_coverage(pictures.f)),
        None,
    ),
    _measure(
        "aurc_random",
        "AURC,\nrandom",
        "The same if trust had no order: the mean of 1 - F.",
        lambda pictures: float((1 - pictures.f).mean()),
        None,
    ),
)
