"""The measures of a run: one object each, in one list that everything else reads.

The list decides what metrics.json holds and in which order, which figures have intervals and
are compared, and which columns the tables on the screen and on the page have. A new measure is
one entry of it, or is given to `evaluate` beside it.
"""

import math
import statistics
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from roadtorch.evaluation import boundary, curves, metrics
from roadtorch.evaluation.measure import Formula, Measure
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.evaluation.tally import Images, Part
from roadtorch.evaluation.trust import TRUST
from roadtorch.layout.classes import CLASSES, NAMES

# --- what formulas are made of ----------------------------------------------------------


def _of_road(figure: Callable[[RoadCounts], Tensor]) -> Formula:
    return lambda part: figure(part.road)


def _of_chosen(figure: Callable[[Decisions], Tensor]) -> Formula:
    """At the chosen threshold; NaN where there is none."""

    def formula(part: Part) -> Tensor:
        if part.chosen is not None:
            return figure(part.chosen)
        return torch.full(part.road.road.shape[:-1], math.nan, dtype=torch.float64)

    return formula


def _of_mask(figure: Callable[[Decisions], Tensor]) -> Formula:
    return lambda part: figure(part.mask)


def _of_images(figure: Callable[[Images], float]) -> Formula:
    """Of the single images, which are not known of draws."""
    return lambda part: None if part.images is None else figure(part.images)


# --- the road ---------------------------------------------------------------------------

MAXF = Measure(
    "maxf",
    "MaxF",
    "Highest F of all thresholds, on pooled pixels. F is the harmonic mean of precision and "
    "recall. The threshold is picked on the labels that score it.",
    lambda part: part.max_f[0],
    interval=True,
    shown=("headline", "parts", "pairs", "compared"),
)

AUC_MEAN = Measure(
    "auc_mean",
    "AUC/image",
    "Mean of the AUCs of single images.",
    lambda part: part.image_auc,
    interval=True,
    shown=("scores", "compared"),
)

IOU = Measure(
    "iou",
    "IoU",
    "Overlap of decided and true road, at the chosen threshold.",
    _of_chosen(metrics.iou),
    interval=True,
    shown=("scores", "pairs", "compared"),
)

F = Measure(
    "f",
    "F",
    "F at the chosen threshold.",
    _of_chosen(metrics.f_measure),
    interval=True,
)

F_MASK = Measure(
    "f_mask",
    "F of mask",
    "F of the detector's own mask, at its default threshold: what a user gets.",
    _of_mask(metrics.f_measure),
    interval=True,
    shown=("headline", "parts", "pairs", "compared"),
)

IOU_MASK = Measure(
    "iou_mask",
    "IoU of mask",
    "Overlap of the detector's own mask, as it ships.",
    _of_mask(metrics.iou),
    interval=True,
    shown=("headline", "parts"),
)

SCORES = (
    Measure(
        "images",
        "images",
        "Images that were scored.",
        _of_images(lambda images: len(images.names)),
        better=None,
        digits=0,
        over_groups="whole",
        shown=("parts",),
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
        over_groups="nothing",
    ),
    Measure(
        "auc_pooled",
        "AUC",
        "Share of pairs (road pixel, other pixel) that the likelihood puts in the right order.",
        _of_road(metrics.auc),
        interval=True,
        shown=("scores", "pairs", "compared"),
    ),
    AUC_MEAN,
    Measure(
        "ap",
        "AP",
        "Best precision at recall 0, 0.1, … 1 or above, averaged (KITTI).",
        _of_road(metrics.average_precision),
        interval=True,
        shown=("scores", "compared"),
    ),
    IOU,
    Measure(
        "eer",
        "EER",
        "Error rate where false positives and misses are as many.",
        _of_road(lambda counts: curves.equal_error_rate(curves.operating_points(counts))),
        better="lower",
        interval=True,
        shown=("scores",),
    ),
    Measure(
        "brier",
        "Brier",
        "Mean squared distance of likelihood and truth.",
        _of_road(curves.brier),
        better="lower",
        interval=True,
        shown=("scores", "compared"),
    ),
    Measure(
        "ms_per_image",
        "ms/image",
        "Median time of one image, detector alone.",
        _of_images(lambda images: 1000 * statistics.median(images.seconds.tolist())),
        better=None,
        digits=1,
        over_groups="whole",
        shown=("scores",),
    ),
    Measure(
        "ece",
        "ECE",
        "Mean distance of the likelihood and the share of road that really has it.",
        _of_road(curves.expected_error),
        better="lower",
        shown=("scores", "parts"),
    ),
)

# --- decisions --------------------------------------------------------------------------

DECISIONS = (
    Measure(
        "threshold",
        "threshold",
        "Likelihood from which a pixel is decided to be road.",
        lambda part: part.threshold,
        better=None,
        over_groups="nothing",
    ),
    F,
    Measure(
        "precision_mask",
        "precision of mask",
        "Fraction of true road in what the detector's own mask calls road.",
        _of_mask(metrics.precision),
        shown=("parts",),
    ),
    Measure(
        "recall_mask",
        "recall of mask",
        "Fraction of the true road that the detector's own mask finds.",
        _of_mask(metrics.recall),
        shown=("parts",),
    ),
)


def _border(place: int, share: float) -> Measure:
    return Measure(
        f"boundary_f/{share:g}",
        f"border F {100 * share:g} %",
        "F of borders: decided and true ones count as met within this share of the diagonal.",
        lambda part: boundary.boundary_f(part.boundary[..., place, :]),
        shown=("parts",) if share == boundary.THREE_PIXELS else (),
    )


BORDERS = tuple(_border(*pair) for pair in enumerate(boundary.TOLERANCES))


# --- the layout: of potentials, and of labels that may abstain ----------------------------


def _layout(
    key: str, name: str, meaning: str, figure: Callable[[Tensor], Tensor], **more: Any
) -> Measure:
    """A figure of the confusion that the key names; more: further fields of the measure."""

    def formula(part: Part) -> Tensor | None:
        confusion = part.labels if key.startswith("labelled") else part.layout
        return None if confusion is None else figure(confusion)

    return Measure(f"layout/{key}", name, meaning, formula, **more)


def _recall(place: int, name: str) -> Measure:
    return _layout(
        name,
        name,
        f"Share of {name} that is found.",
        lambda confusion: metrics.class_recalls(confusion)[..., place],
        shown=("layout",),
    )


def _confusion(truth: int, decided: int) -> Measure:
    true, other = NAMES[truth], NAMES[decided]
    return _layout(
        f"confusion/{true}/{other}",
        f"{true} as {other}",
        f"Share of {true} that is decided to be {other}.",
        lambda confusion: metrics.normalised_confusion(confusion)[..., truth, decided],
        better=None,
    )


LAYOUT = (
    *(_recall(*pair) for pair in enumerate(NAMES)),
    _layout(
        "mean",
        "mean",
        "Mean of the three.",
        metrics.mean_class_recall,
        interval=True,
        shown=("layout", "compared"),
    ),
    _layout(
        "accuracy",
        "accuracy",
        "Share of all pixels that are right.",
        metrics.layout_accuracy,
        shown=("layout",),
    ),
    *(_confusion(truth, decided) for truth in range(CLASSES) for decided in range(CLASSES)),
    _layout(
        "void_as_vertical/mean",
        "mean, void vertical",
        "Mean of the three, void counted as vertical.",
        lambda confusion: metrics.mean_class_recall(metrics.void_as_vertical(confusion)),
        shown=("layout",),
    ),
    _layout(
        "labelled/mean",
        "mean, labelled",
        "Mean of the three, where the labeller does not abstain.",
        metrics.mean_class_recall,
        shown=("layout",),
    ),
    _layout(
        "labelled_share",
        "labelled share",
        "Share of pixels with a label.",
        metrics.labelled_share,
        shown=("layout",),
    ),
)


MEASURES: tuple[Measure, ...] = (
    *SCORES,
    *DECISIONS,
    *BORDERS,
    *TRUST,
    *LAYOUT,
)
"""All measures, in the order in which files and tables have them."""
