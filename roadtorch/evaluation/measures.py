"""Measures of an evaluation: one object each, in one list that everything else reads.

The list decides what metrics.json holds and in which order, which measures have intervals and
are compared, and which columns the tables on the screen and in the report have. To add a measure,
append it here or pass it to `evaluate`.
"""

import math
import statistics
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from roadtorch.evaluation import boundary, curves, metrics
from roadtorch.evaluation.measure import Formula, Measure
from roadtorch.evaluation.metrics import ConfusionCounts, RoadCounts
from roadtorch.evaluation.tally import ImageTable, PooledCounts
from roadtorch.evaluation.trust_measures import TRUST_MEASURES
from roadtorch.layout.classes import CLASS_NAMES

# --- formulas ----------------------------------------------------------


def _from_road(function: Callable[[RoadCounts], Tensor]) -> Formula:
    return lambda part: function(part.road)


def _at_chosen_threshold(function: Callable[[ConfusionCounts], Tensor]) -> Formula:
    """Apply a function to the counts at the chosen threshold; NaN where there is none."""

    def formula(part: PooledCounts) -> Tensor:
        if part.at_threshold is not None:
            return function(part.at_threshold)
        return torch.full(part.road.road.shape[:-1], math.nan, dtype=torch.float64)

    return formula


def _from_mask(function: Callable[[ConfusionCounts], Tensor]) -> Formula:
    return lambda part: function(part.mask)


def _from_images(function: Callable[[ImageTable], float]) -> Formula:
    """Apply a function to the single images, which bootstrap replicates do not have."""
    return lambda part: None if part.images is None else function(part.images)


# --- the road ---------------------------------------------------------------------------

MAXF = Measure(
    "maxf",
    "MaxF",
    "Highest F over all thresholds, on pooled pixels. F is the harmonic mean of precision and "
    "recall. The threshold is chosen on the same labels.",
    lambda part: part.max_f[0],
    interval=True,
    tables=("headline", "parts", "pairs", "compared"),
)

AUC_MEAN = Measure(
    "auc_mean",
    "AUC/image",
    "Mean of the AUCs of single images.",
    lambda part: part.image_auc,
    interval=True,
    tables=("scores", "compared"),
)

IOU = Measure(
    "iou",
    "IoU",
    "Intersection over union of predicted and true road, at the chosen threshold.",
    _at_chosen_threshold(metrics.iou),
    interval=True,
    tables=("scores", "pairs", "compared"),
)

F = Measure(
    "f", "F", "F at the chosen threshold.", _at_chosen_threshold(metrics.f_measure), interval=True
)

F_MASK = Measure(
    "f_mask",
    "F of mask",
    "F of the detector's mask at its default threshold, as a user gets it.",
    _from_mask(metrics.f_measure),
    interval=True,
    tables=("headline", "parts", "pairs", "compared"),
)

IOU_MASK = Measure(
    "iou_mask",
    "IoU of mask",
    "Intersection over union of the detector's mask, at its default threshold.",
    _from_mask(metrics.iou),
    interval=True,
    tables=("headline", "parts"),
)

ROAD_MEASURES = (
    Measure(
        "images",
        "images",
        "Number of images scored.",
        _from_images(lambda images: len(images.names)),
        better=None,
        digits=0,
        aggregate="whole",
        tables=("parts",),
    ),
    F_MASK,
    IOU_MASK,
    MAXF,
    Measure(
        "maxf_threshold",
        "threshold of MaxF",
        "Lowest threshold that reaches MaxF.",
        lambda part: part.max_f[1],
        better=None,
        aggregate="nothing",
    ),
    Measure(
        "auc_pooled",
        "AUC",
        "Fraction of pairs of a road and a background pixel in which the road has the higher "
        "likelihood.",
        _from_road(metrics.auc),
        interval=True,
        tables=("scores", "pairs", "compared"),
    ),
    AUC_MEAN,
    Measure(
        "ap",
        "AP",
        "Mean over the recalls 0, 0.1, … 1 of the best precision at that recall or above (KITTI).",
        _from_road(metrics.average_precision),
        interval=True,
        tables=("scores", "compared"),
    ),
    IOU,
    Measure(
        "eer",
        "EER",
        "Rate at which the false positive and the false negative rate are equal.",
        _from_road(lambda counts: curves.equal_error_rate(curves.operating_points(counts))),
        better="lower",
        interval=True,
        tables=("scores",),
    ),
    Measure(
        "brier",
        "Brier",
        "Mean squared difference of likelihood and truth.",
        _from_road(curves.brier_score),
        better="lower",
        interval=True,
        tables=("scores", "compared"),
    ),
    Measure(
        "ms_per_image",
        "ms/image",
        "Median time of the detector per image, in milliseconds.",
        _from_images(lambda images: 1000 * statistics.median(images.seconds.tolist())),
        better=None,
        digits=1,
        aggregate="whole",
        tables=("scores",),
    ),
    Measure(
        "ece",
        "ECE",
        "Expected calibration error: mean difference of the likelihood and the observed fraction "
        "of road.",
        _from_road(curves.expected_calibration_error),
        better="lower",
        tables=("scores", "parts"),
    ),
)

# --- masks --------------------------------------------------------------------------

DECISION_MEASURES = (
    Measure(
        "threshold",
        "threshold",
        "Likelihood from which a pixel is road.",
        lambda part: part.threshold,
        better=None,
        aggregate="nothing",
    ),
    F,
    Measure(
        "precision_mask",
        "precision of mask",
        "Fraction of the detector's mask that is road.",
        _from_mask(metrics.precision),
        tables=("parts",),
    ),
    Measure(
        "recall_mask",
        "recall of mask",
        "Fraction of the true road that the detector's mask covers.",
        _from_mask(metrics.recall),
        tables=("parts",),
    ),
)


def _boundary_measure(index: int, tolerance: float) -> Measure:
    return Measure(
        f"boundary_f/{tolerance:g}",
        f"boundary F {100 * tolerance:g} %",
        "F of the road boundary, matched within this fraction of the image diagonal.",
        lambda part: boundary.boundary_f(part.boundary[..., index, :]),
        tables=("parts",) if tolerance == boundary.TIGHT_TOLERANCE else (),
    )


BOUNDARY_MEASURES = tuple(_boundary_measure(*pair) for pair in enumerate(boundary.TOLERANCES))


# --- the layout --------------------------------------------------------------------------


def _layout_measure(
    key: str, name: str, meaning: str, function: Callable[[Tensor], Tensor], **more: Any
) -> Measure:
    """Return a measure of the confusion; more: further fields of ``Measure``."""

    def formula(part: PooledCounts) -> Tensor | None:
        return None if part.layout is None else function(part.layout)

    more.setdefault("tables", ("layout",))
    return Measure(f"layout/{key}", name, meaning, formula, **more)


def _recall_measure(index: int, name: str) -> Measure:
    meaning = f"Fraction of {name} pixels labelled {name}."
    return _layout_measure(name, name, meaning, lambda c: metrics.class_recalls(c)[..., index])


LAYOUT_MEASURES = (
    *(_recall_measure(*pair) for pair in enumerate(CLASS_NAMES)),
    _layout_measure(
        "mean",
        "mean",
        "Mean recall of the three classes.",
        metrics.mean_class_recall,
        interval=True,
        tables=("layout", "compared"),
    ),
    _layout_measure(
        "void_as_vertical/mean",
        "mean, void vertical",
        "Mean recall of the three classes, void counted as vertical.",
        lambda confusion: metrics.mean_class_recall(metrics.void_as_vertical(confusion)),
    ),
)


MEASURES: tuple[Measure, ...] = (
    *ROAD_MEASURES,
    *DECISION_MEASURES,
    *BOUNDARY_MEASURES,
    *TRUST_MEASURES,
    *LAYOUT_MEASURES,
)
"""All measures, in the order of files and tables."""
