"""Curves over thresholds: ROC, its average over images, reliability.

A curve is made from counts (`roadtorch.evaluation.metrics.RoadCounts`), never from sorted
likelihoods, so the order of equal ones cannot matter: every level is one point, and several
road and background pixels on one level make one slanted segment.

P3 reports "average ROC curves" without defining the average. Two are available:

- vertical: the mean TPR of the images at a given FPR (`vertical_sample` of each image, then
  `vertical_average` of the mean; Fawcett, An introduction to ROC analysis, 2006). Every image
  has the same weight.
- pooled: `operating_points` of the summed counts; images with more road have more weight.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from roadtorch.evaluation.metrics import RoadCounts

FPR_STEPS = 100  # intervals of the false positive rate, in vertical averaging


@dataclass(frozen=True, eq=False)
class Curve:
    """Points along curves, float64 (..., points)."""

    x: Tensor
    y: Tensor


# --- ROC --------------------------------------------------------------------------------


def operating_points(counts: RoadCounts) -> Curve:
    """Compute the ROC: FPR and TPR at every level, (..., levels) → (..., levels + 1).

    It goes from (0, 0), where nothing is road, to (1, 1); at point i every pixel with level
    ≥ levels - i is road, so that pixels of one level make one point (protocols of P2 and P3). NaN
    where road (y) or background (x) is missing. Levels without pixels repeat a point.
    """
    false, true = (sums.to(torch.float64) for sums in _cumulative_counts(counts))
    return Curve(false / false[..., -1:], true / true[..., -1:])


def _cumulative_counts(counts: RoadCounts) -> tuple[Tensor, Tensor]:
    """Return false and true positives, int64 (..., levels + 1), of the top 0, 1, 2, … levels."""
    false, true = (
        torch.nn.functional.pad(part.flip(-1).cumsum(-1), (1, 0))
        for part in (counts.background, counts.road)
    )
    return false, true


# --- averages ---------------------------------------------------------------------------


def vertical_sample(counts: RoadCounts, steps: int = FPR_STEPS) -> Tensor:
    """Sample the TPR of each map at the FPRs 0, 1/steps, …, 1: (..., levels) → (..., steps + 1).

    Linear between the points of the curve; at a vertical segment its upper end. FPRs are compared
    in whole pixels, so rounding cannot change the side of a step. Float64; NaN without road or
    background.
    """
    false, true = _cumulative_counts(counts)
    background, road = false[..., -1:], true[..., -1:]
    scaled = torch.arange(steps + 1) * background  # steps × the false positives at each FPR
    index = torch.searchsorted(false, scaled.div(steps, rounding_mode="floor"), right=True) - 1
    after = (index + 1).clamp(max=counts.levels)
    low, high = false.gather(-1, index), false.gather(-1, after)
    width = (steps * (high - low)).clamp(min=1)  # 0 only at the last level, where nothing is added
    fraction = (scaled - steps * low).to(torch.float64) / width
    start = true.gather(-1, index)
    hits = start + fraction * (true.gather(-1, after) - start)
    return (hits / road).where(background > 0, torch.nan)


def vertical_average(true_rates: Tensor) -> Curve:
    """Return the curve of mean TPRs (..., steps + 1) at equally spaced FPRs, starting at (0, 0)."""
    false_rates = torch.linspace(0, 1, true_rates.shape[-1], dtype=torch.float64)
    return Curve(
        torch.nn.functional.pad(false_rates, (1, 0)).expand(*true_rates.shape[:-1], -1),
        torch.nn.functional.pad(true_rates, (1, 0)),
    )


# --- scores ----------------------------------------------------------------------------


def area(curve: Curve) -> Tensor:
    """Compute the area under curves by the trapezoid rule, float64 (...)."""
    return torch.trapezoid(curve.y, curve.x)


# --- calibration: is a fraction p of the pixels with likelihood p road? --------------------

# Likelihoods are those of the levels, at the default 65,536 less than 1e-5 from the pixels'. Brier,
# Monthly Weather Review 1950; Naeini, Cooper, Hauskrecht, AAAI 2015 (expected calibration error).

CALIBRATION_BINS = 20


@dataclass(frozen=True, eq=False)
class Reliability:
    """Pixels binned by likelihood, float64 (..., bins) each; NaN in bins without pixels."""

    predicted: Tensor  # mean likelihood
    observed: Tensor  # fraction of road
    fraction: Tensor  # of all pixels; NaN only if no pixel was counted


def brier_score(counts: RoadCounts) -> Tensor:
    """Compute the mean squared difference of likelihood and truth, float64 (...)."""
    likelihood, road, background = _levels(counts)
    wrong = road * (1 - likelihood) ** 2 + background * likelihood**2
    return wrong.sum(-1) / (road + background).sum(-1)


def reliability(counts: RoadCounts, bins: int = CALIBRATION_BINS) -> Reliability:
    """Compute the reliability diagram over bins of equal width: (..., levels) → (..., bins).

    A likelihood on an edge belongs to the lower bin, as in scikit-learn's calibration_curve.
    """
    likelihood, road, background = _levels(counts)
    steps = counts.levels - 1
    level = torch.arange(counts.levels)  # integers, so that edges are exact
    index = ((level * bins + steps - 1) // steps - 1).clamp(min=0)
    pixels, road_pixels, predicted = (
        torch.zeros((*part.shape[:-1], bins), dtype=part.dtype).index_add_(-1, index, part)
        for part in (road + background, road, (road + background) * likelihood)
    )
    fraction = pixels / pixels.sum(-1, keepdim=True)
    return Reliability(predicted / pixels, road_pixels / pixels, fraction)


def expected_calibration_error(counts: RoadCounts, bins: int = CALIBRATION_BINS) -> Tensor:
    """Compute the mean distance of predicted and observed road over pixels, float64 (...)."""
    curve = reliability(counts, bins)
    distance = (curve.observed - curve.predicted).abs().nan_to_num(0)
    return (curve.fraction * distance).sum(-1)


def _levels(counts: RoadCounts) -> tuple[Tensor, Tensor, Tensor]:
    """Return the likelihood of each level, and the counts of road and background, as float64."""
    likelihood = torch.arange(counts.levels, dtype=torch.float64) / (counts.levels - 1)
    return likelihood, counts.road.to(torch.float64), counts.background.to(torch.float64)
