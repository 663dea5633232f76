"""Measures of road maps and layout labels: count first, then apply formulas to the counts.

Maps are counted into histograms of likelihood levels, one for road and one for background.
Counts are integers that add up, so memory does not grow with the number of images, and pooling
is a sum. Every formula takes counts alone, with any number of leading dimensions.

The default 65,536 levels are those of a 16-bit map: the 256 levels of an 8-bit map are
among them (level 257·q), so 8- and 16-bit maps are measured exactly, and other values
tie only where they round to the same level. "≥ threshold" means road (KITTI's reading).

Sources: "KITTI" is the road benchmark's development kit (Fritsch, Kühnl, Geiger, ITSC
2013); P1 is Zhang et al., ICPR 2016; P2 is Álvarez et al., ECCV 2012.
"""

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from roadtorch.base.errors import InputError, check_unit_range
from roadtorch.layout.classes import NUM_CLASSES

DEFAULT_LEVELS = 65_536
EPSILON = 1e-10  # KITTI adds it to its denominators
RECALL_STEPS = 11  # of KITTI's average precision: 0, 0.1, …, 1


# --- counts -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RoadCounts:
    """Pixels by likelihood level: int64 (..., levels) of true road and of true background."""

    road: Tensor
    background: Tensor

    def __add__(self, more: "RoadCounts") -> "RoadCounts":
        """Return the counts of both sets of maps together."""
        return RoadCounts(self.road + more.road, self.background + more.background)

    @property
    def levels(self) -> int:
        """Number of levels that the likelihood was rounded to."""
        return self.road.shape[-1]

    def __reduce__(self) -> tuple[Callable[..., "RoadCounts"], tuple[np.ndarray, ...]]:
        """Pickle the nonzero levels alone: one image has few of the 65,536."""
        stacked = torch.stack([self.road, self.background]).numpy()
        indices = np.flatnonzero(stacked).astype(np.int32)
        return _from_sparse, (np.array(stacked.shape), indices, stacked.reshape(-1)[indices])


def _from_sparse(shape: np.ndarray, indices: np.ndarray, counts: np.ndarray) -> RoadCounts:
    stacked = np.zeros(shape, counts.dtype)
    stacked.reshape(-1)[indices] = counts
    return RoadCounts(*torch.from_numpy(stacked))


class ConfusionCounts(NamedTuple):
    """Pixels by decision and truth: int64 tensors of one shape, often scalars."""

    true_positive: Tensor
    false_positive: Tensor
    false_negative: Tensor
    true_negative: Tensor

    def __add__(self, more: "ConfusionCounts") -> "ConfusionCounts":  # type: ignore[override]
        """Return the counts of both sets of masks together."""
        return ConfusionCounts(*map(operator.add, self, more))


def quantise(likelihood: Tensor, levels: int = DEFAULT_LEVELS) -> Tensor:
    """Round a likelihood to the nearest of equally spaced levels of [0, 1]; int32, same shape."""
    # Of what is not negative, taking the whole part is rounding down.
    return (likelihood * (levels - 1) + 0.5).to(torch.int32)


def threshold_level(threshold: float, levels: int = DEFAULT_LEVELS) -> int:
    """Return the lowest level that reaches a threshold in [0, 1]."""
    # The small allowance lets k / (levels - 1), rounded, still mean level k.
    return math.ceil(threshold * (levels - 1) - 1e-6)


def count_levels(
    likelihood: Tensor, road: Tensor, valid: Tensor, levels: int = DEFAULT_LEVELS
) -> RoadCounts:
    """Count the valid pixels of one map by likelihood level.

    Args:
        likelihood: float (H, W) in [0, 1].
        road: true road, bool (H, W).
        valid: pixels with truth, bool (H, W); others are ignored.
        levels: number of levels that the likelihood is rounded to.

    Raises:
        InputError: when the sizes differ or a likelihood is not in [0, 1].
    """
    if likelihood.shape != road.shape:
        problem = f"has the shape {tuple(likelihood.shape)}, the truth {tuple(road.shape)}"
        raise InputError("likelihood", problem, "return a map of the image's size")
    low, high = (float(bound) for bound in torch.aminmax(likelihood))
    check_unit_range("likelihood", low, high, "return values in [0, 1]")
    # One histogram: background, then road, then one bin for void.
    index = quantise(likelihood, levels).add_(road, alpha=levels).masked_fill_(~valid, 2 * levels)
    counts = torch.bincount(index.flatten(), minlength=2 * levels + 1)
    return RoadCounts(counts[levels : 2 * levels].clone(), counts[:levels].clone())


def count_mask(mask: Tensor, road: Tensor, valid: Tensor) -> ConfusionCounts:
    """Count the valid pixels of one mask by decision and truth; all bool (H, W)."""
    predicted, true = mask & valid, road & valid
    true_positive = (predicted & true).sum()
    false_positive, false_negative = predicted.sum() - true_positive, true.sum() - true_positive
    true_negative = valid.sum() - true_positive - false_positive - false_negative
    return ConfusionCounts(true_positive, false_positive, false_negative, true_negative)


def coarsen(counts: RoadCounts, levels: int = 256) -> RoadCounts:
    """Return the counts of the same maps rounded to fewer levels, such as those of an 8-bit PNG."""
    fine = torch.arange(counts.levels, dtype=torch.float64) / (counts.levels - 1)
    index = quantise(fine, levels)
    shape = (*counts.road.shape[:-1], levels)
    road, background = (
        torch.zeros(shape, dtype=part.dtype).index_add_(-1, index, part)
        for part in (counts.road, counts.background)
    )
    return RoadCounts(road, background)


def confusion_at(counts: RoadCounts, threshold: float) -> ConfusionCounts:
    """Return the counts of the mask "likelihood ≥ threshold", at the resolution of the levels."""
    level = threshold_level(threshold, counts.levels)
    road, background = counts.road.sum(-1), counts.background.sum(-1)
    hit, false = (part[..., level:].sum(-1) for part in (counts.road, counts.background))
    return ConfusionCounts(hit, false, road - hit, background - false)


# --- formulas; 0/0 is NaN, never 0 or 1 ---------------------------------------------------


# Given the summed counts of a data set, precision, recall and f_measure are P, R and F of
# P1, eq. 11 (Table I). They are not the means of the images' scores.


def precision(counts: ConfusionCounts) -> Tensor:
    """Compute TP / (TP + FP), float64; NaN where nothing is predicted as road."""
    return _ratio(counts.true_positive, counts.true_positive + counts.false_positive)


def recall(counts: ConfusionCounts) -> Tensor:
    """Compute TP / (TP + FN), float64; NaN where there is no road."""
    return _ratio(counts.true_positive, counts.true_positive + counts.false_negative)


def iou(counts: ConfusionCounts) -> Tensor:
    """Compute TP / (TP + FP + FN), float64; NaN where there is neither true nor predicted road."""
    wrong = counts.false_positive + counts.false_negative
    return _ratio(counts.true_positive, counts.true_positive + wrong)


def f_measure(counts: ConfusionCounts) -> Tensor:
    """Compute 2 TP / (2 TP + FP + FN), the harmonic mean of precision and recall, float64."""
    wrong = counts.false_positive + counts.false_negative
    return _ratio(2 * counts.true_positive, 2 * counts.true_positive + wrong)


def false_positive_rate(counts: ConfusionCounts) -> Tensor:
    """Compute FP / (FP + TN), float64; NaN where there is no background."""
    return _ratio(counts.false_positive, counts.false_positive + counts.true_negative)


def _ratio(part: Tensor, whole: Tensor) -> Tensor:
    return part.to(torch.float64) / whole.to(torch.float64)


def auc(counts: RoadCounts) -> Tensor:
    """Compute the area under the ROC curve: P(road above background), ties one half; float64 (...).

    NaN without road or background. Equals the trapezoid area (Fawcett 2006).
    """
    road, background = counts.road.to(torch.float64), counts.background.to(torch.float64)
    below = background.cumsum(-1) - background / 2
    return (road * below).sum(-1) / (road.sum(-1) * background.sum(-1))


def kitti_precision_recall(counts: RoadCounts) -> tuple[Tensor, Tensor]:
    """Compute KITTI's precision and recall for every level, float64 (..., levels) each."""
    hit, false = (  # how many pixels have each level or a higher one
        part.flip(-1).cumsum(-1).flip(-1).to(torch.float64)
        for part in (counts.road, counts.background)
    )
    return hit / (hit + false + EPSILON), hit / hit[..., :1]


def f_curve(counts: RoadCounts) -> Tensor:
    """Compute KITTI's F for every level, float64 (..., levels); NaN where there is no road."""
    precisions, recalls = kitti_precision_recall(counts)
    return 2 * precisions * recalls / (precisions + recalls + EPSILON)


def max_f(counts: RoadCounts) -> tuple[Tensor, Tensor]:
    """Compute KITTI's MaxF, and the lowest threshold in [0, 1] that reaches it; float64 (...)."""
    return best_threshold(f_curve(counts))


def best_threshold(curve: Tensor) -> tuple[Tensor, Tensor]:
    """Return the maximum of curves (..., levels) and the first threshold that reaches it."""
    best = curve.argmax(-1)  # the first one of several
    value = curve.gather(-1, best[..., None])[..., 0]
    threshold = best.to(torch.float64) / (curve.shape[-1] - 1)
    return value, threshold.where(~value.isnan(), torch.nan)


def average_precision(counts: RoadCounts) -> Tensor:
    """Compute KITTI's AP: mean over the recalls 0, 0.1, …, 1 of the best precision at or above it.

    The recalls are accumulated in floating point as in the kit (0.30000000000000004), so that a
    recall of exactly 0.3, 0.6 or 0.7 falls short of its step in both.
    """
    precisions, recalls = kitti_precision_recall(counts)
    steps = torch.arange(RECALL_STEPS, dtype=torch.float64) * 0.1
    best = [(precisions * (recalls >= step)).amax(-1) for step in steps]
    return torch.stack(best).mean(0).where(~recalls[..., 0].isnan(), torch.nan)


# --- layout -----------------------------------------------------------------------------


def count_layout(labels: Tensor, truth: Tensor) -> Tensor:
    """Count layout labels against the truth, int64 (4, 4): rows truth, columns decision.

    labels, truth: integer (H, W), 0 sky, 1 vertical, 2 horizontal, 255 unlabelled or void. The
    fourth row is void, the fourth column unlabelled.
    """
    rows, columns = (part.to(torch.int64).clamp(max=NUM_CLASSES) for part in (truth, labels))
    side = NUM_CLASSES + 1
    pairs = (rows * side + columns).flatten()
    return torch.bincount(pairs, minlength=side**2).reshape(side, side)


# The functions below ignore void and unlabelled pixels and take any leading dimensions.


def void_as_vertical(confusion: Tensor) -> Tensor:
    """Return the confusion (..., 4, 4) as P2 may be read literally: void counts as vertical."""
    moved = confusion.clone()
    moved[..., 1, :] += moved[..., 3, :]
    moved[..., 3, :] = 0
    return moved


def normalised_confusion(confusion: Tensor) -> Tensor:
    """Normalise each true class over decisions, (..., 4, 4) → float64 (..., 3, 3) (P2, Fig. 4b).

    Rows sum to 1, or are NaN for a class without pixels. The order is sky, vertical, horizontal; P2
    prints vertical, horizontal, sky.
    """
    labelled = confusion[..., :3, :3]
    return _ratio(labelled, labelled.sum(-1, keepdim=True))


def class_recalls(confusion: Tensor) -> Tensor:
    """Compute the recall of sky, vertical, horizontal, float64 (..., 3); NaN without pixels."""
    return normalised_confusion(confusion).diagonal(dim1=-2, dim2=-1)


def mean_class_recall(confusion: Tensor) -> Tensor:
    """Compute the mean recall over the classes that have pixels, float64 (...).

    P2 calls it "global average accuracy (normalized diagonal)".
    """
    return class_recalls(confusion).nanmean(-1)
