"""Curves over thresholds: ROC, its average over images, reliability.

A curve is made from counts (`roadtorch.evaluation.metrics.RoadCounts`), never from sorted
scores, so the order of equal scores cannot matter: every level is one point, and several
road and background pixels on one level make one slanted piece.

P3 speaks of "average ROC curves" without saying which. Two are here:

- vertical: the mean TPR of the images at a given FPR (`vertical_sample` of each image, then
  `vertical_average` of the mean; Fawcett, An introduction to ROC analysis, 2006). Every image
  weighs the same.
- pooled: `roc` of the summed counts; images with more road weigh more.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from roadtorch.evaluation.metrics import RoadCounts

STEPS = 100  # of the false positive rate, in vertical averaging


@dataclass(frozen=True)
class Curve:
    """Points along curves, float64 (...,points)."""

    x: Tensor
    y: Tensor


# --- ROC --------------------------------------------------------------------------------


def operating_points(counts: RoadCounts) -> Curve:
    """FPR and TPR at every level: (...,levels) → (...,levels+1), from (0,0) to (1,1).

    The first point calls nothing road; point i calls "level ≥ levels - i" road. NaN where
    road (y) or background (x) is missing. Levels without pixels repeat a point.
    """
    false, true = _counted_from_the_top(counts)
    return Curve(_share_of_last(false), _share_of_last(true))


def roc(counts: RoadCounts) -> Curve:
    """The ROC curve of one map or of pooled maps, counts (levels,): each point once.

    From (0,0) to (1,1); pixels that share a level make one point (protocols of P2 and P3).
    """
    every = operating_points(counts)
    kept = torch.cat([torch.ones(1, dtype=torch.bool), _occupied(counts)])
    return Curve(every.x[kept], every.y[kept])


def _counted_from_the_top(counts: RoadCounts) -> tuple[Tensor, Tensor]:
    """False and true positives, int64 (...,levels+1), of nothing, the top level, the top two…"""
    false, true = (
        torch.nn.functional.pad(part.flip(-1).cumsum(-1), (1, 0))
        for part in (counts.other, counts.road)
    )
    return false, true


def _share_of_last(sums: Tensor) -> Tensor:
    return sums.to(torch.float64) / sums[..., -1:]


def _occupied(counts: RoadCounts) -> Tensor:
    """Levels that have pixels, highest first; bool (levels,)."""
    return (counts.road + counts.other).flip(-1) > 0


# --- averages ---------------------------------------------------------------------------


def vertical_sample(counts: RoadCounts, steps: int = STEPS) -> Tensor:
    """TPR of each map at the FPRs 0, 1/steps, …, 1: (...,levels) → float64 (...,steps+1).

    Where the curve rises vertically, its upper end; elsewhere linear between its points.
    NaN where road or background is missing: skip such images and count them. The FPRs are
    compared in whole pixels, so that no rounding decides which side of a step is meant.
    """
    false, true = _counted_from_the_top(counts)
    background, road = false[..., -1:], true[..., -1:]
    scaled = torch.arange(steps + 1) * background  # steps × the false positives wanted
    at = torch.searchsorted(false, scaled.div(steps, rounding_mode="floor"), right=True) - 1
    after = (at + 1).clamp(max=counts.levels)
    low, high = false.gather(-1, at), false.gather(-1, after)
    width = (steps * (high - low)).clamp(min=1)  # 0 only at the end, where nothing is added
    share = (scaled - steps * low).to(torch.float64) / width
    start = true.gather(-1, at)
    hits = start + share * (true.gather(-1, after) - start)
    return (hits / road).where(background > 0, torch.nan)


def vertical_average(true_rates: Tensor) -> Curve:
    """The curve of mean TPRs (...,steps+1) at equally spaced FPRs, with (0,0) put before."""
    false_rates = torch.linspace(0, 1, true_rates.shape[-1], dtype=torch.float64)
    return Curve(
        torch.nn.functional.pad(false_rates, (1, 0)).expand(*true_rates.shape[:-1], -1),
        torch.nn.functional.pad(true_rates, (1, 0)),
    )


# --- figures ----------------------------------------------------------------------------


def area(curve: Curve) -> Tensor:
    """Area under curves by the trapezoid rule, float64 (...)."""
    return torch.trapezoid(curve.y, curve.x)


def equal_error_rate(curve: Curve) -> Tensor:
    """Where a ROC curve has FPR = 1 - TPR, linear between its points; float64 (...).

    Needs curves that begin at (0,0). NaN where the curve is not defined.
    """
    excess = 1 - curve.y - curve.x  # from 1 down to -1
    after = (excess <= 0).to(torch.uint8).argmax(-1, keepdim=True).clamp(min=1)
    above, below = excess.gather(-1, after - 1), excess.gather(-1, after)
    before, x = curve.x.gather(-1, after - 1), curve.x.gather(-1, after)
    return (before + above / (above - below) * (x - before))[..., 0]


# --- calibration: of pixels said to be road with p, is the share p road? -------------------

# Pixels are scored by the level their likelihood was rounded to, at the default 65,536 levels less
# than a hundred-thousandth away. Brier, Monthly Weather Review 1950; Naeini, Cooper, Hauskrecht,
# AAAI 2015 (expected calibration error).

BINS = 20


@dataclass(frozen=True)
class Reliability:
    """Pixels binned by likelihood, float64 (...,bins) each; NaN in bins without pixels."""

    predicted: Tensor  # mean likelihood
    observed: Tensor  # share of road
    share: Tensor  # of all pixels; never NaN unless nothing was counted


def brier(counts: RoadCounts) -> Tensor:
    """Mean squared difference of likelihood and truth, float64 (...); NaN without pixels."""
    likelihood, road, other = _levels(counts)
    wrong = road * (1 - likelihood) ** 2 + other * likelihood**2
    return wrong.sum(-1) / (road + other).sum(-1)


def reliability(counts: RoadCounts, bins: int = BINS) -> Reliability:
    """The reliability curve over equally wide bins of likelihood, (...,levels) → (...,bins).

    A likelihood on an edge belongs to the lower bin, as in scikit-learn's calibration_curve.
    """
    likelihood, road, other = _levels(counts)
    steps = counts.levels - 1
    level = torch.arange(counts.levels)  # whole numbers, so that edges are met exactly
    index = ((level * bins + steps - 1) // steps - 1).clamp(min=0)
    here, on_road, predicted = (
        torch.zeros((*part.shape[:-1], bins), dtype=part.dtype).index_add_(-1, index, part)
        for part in (road + other, road, (road + other) * likelihood)
    )
    return Reliability(predicted / here, on_road / here, here / here.sum(-1, keepdim=True))


def expected_error(counts: RoadCounts, bins: int = BINS) -> Tensor:
    """Expected calibration error: the mean distance of said and observed over pixels, (...)."""
    curve = reliability(counts, bins)
    distance = (curve.observed - curve.predicted).abs().nan_to_num(0)
    return (curve.share * distance).sum(-1)


def _levels(counts: RoadCounts) -> tuple[Tensor, Tensor, Tensor]:
    """Likelihood of each level, and the counts, as float64."""
    likelihood = torch.arange(counts.levels, dtype=torch.float64) / (counts.levels - 1)
    return likelihood, counts.road.to(torch.float64), counts.other.to(torch.float64)
