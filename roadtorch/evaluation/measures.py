"""Measures of an evaluation: one object each, in one list that everything else reads.

The list decides what metrics.json holds and in which order, which measures have intervals and
are compared, and which columns the tables on the screen and in the report have. To add a measure,
append it here or pass it to `evaluate`.
"""

import statistics
from collections.abc import Callable
from typing import Any

from torch import Tensor

from roadtorch.evaluation import boundary, curves, metrics
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.tally import PooledCounts
from roadtorch.evaluation.trust_measures import TRUST_MEASURES
from roadtorch.layout.classes import CLASS_NAMES


def _median_milliseconds(part: PooledCounts) -> float | None:
    seconds = [] if part.images is None else part.images.seconds.tolist()
    return 1000 * statistics.median(seconds) if seconds else None


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
    lambda part: metrics.iou(part.at_threshold),
    interval=True,
    tables=("scores", "pairs", "compared"),
)

F = Measure(
    "f",
    "F",
    "F at the chosen threshold.",
    lambda part: metrics.f_measure(part.at_threshold),
    interval=True,
)

F_MASK = Measure(
    "f_mask",
    "F of mask",
    "F of the detector's mask at its default threshold, as a user gets it.",
    lambda part: metrics.f_measure(part.mask),
    interval=True,
    tables=("headline", "parts", "pairs", "compared"),
)

IOU_MASK = Measure(
    "iou_mask",
    "IoU of mask",
    "Intersection over union of the detector's mask, at its default threshold.",
    lambda part: metrics.iou(part.mask),
    interval=True,
    tables=("headline", "parts"),
)

ROAD_MEASURES = (
    Measure(
        "images",
        "images",
        "Number of images scored.",
        lambda part: None if part.images is None else len(part.images.names),
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
        lambda part: metrics.auc(part.road),
        interval=True,
        tables=("scores", "pairs", "compared"),
    ),
    AUC_MEAN,
    Measure(
        "ap",
        "AP",
        "Mean over the recalls 0, 0.1, … 1 of the best precision at that recall or above (KITTI).",
        lambda part: metrics.average_precision(part.road),
        interval=True,
        tables=("scores", "compared"),
    ),
    IOU,
    Measure(
        "brier",
        "Brier",
        "Mean squared difference of likelihood and truth.",
        lambda part: curves.brier_score(part.road),
        better="lower",
        interval=True,
        tables=("scores", "compared"),
    ),
    Measure(
        "ms_per_image",
        "ms/image",
        "Median time of the detector per image, in milliseconds.",
        _median_milliseconds,
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
        lambda part: curves.expected_calibration_error(part.road),
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
        lambda part: metrics.precision(part.mask),
        tables=("parts",),
    ),
    Measure(
        "recall_mask",
        "recall of mask",
        "Fraction of the true road that the detector's mask covers.",
        lambda part: metrics.recall(part.mask),
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
