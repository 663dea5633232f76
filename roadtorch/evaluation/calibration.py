"""Whether a likelihood can be read as a probability: of pixels said to be road with p, is p road?

Everything is computed from counts by level, so pixels are scored by the level their
likelihood was rounded to, at the default 65,536 levels less than a hundred-thousandth away.

Sources: Brier, Monthly Weather Review 1950; Naeini, Cooper, Hauskrecht, AAAI 2015 (expected
calibration error).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from roadtorch.evaluation.metrics import RoadCounts

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
