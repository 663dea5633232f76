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
from roadtorch.evaluation.tally import Part, Pictures
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


def _of_roc(figure: Callable[[curves.Curve], Tensor]) -> Formula:
    """Of the average curve of the pictures; NaN without a picture that has one."""

    def formula(part: Part) -> Tensor | float:
        return math.nan if part.rates is None else figure(curves.vertical_average(part.rates))

    return formula


def _of_pictures(figure: Callable[[Pictures], float]) -> Formula:
    """Of the single pictures, which are not known of draws."""
    return lambda part: None if part.pictures is None else figure(part.pictures)


# --- the road ---------------------------------------------------------------------------

MAXF = Measure(
    "maxf",
    "MaxF",
    "Highest F of all thresholds, on pooled pixels. F is the harmonic mean of precision and "
    "recall. The threshold is picked on the labels that score it.",
    lambda part: part.max_f[0],
    interval=True,
    shown=("headline", "parts", "screen pairs", "pairs"),
)

AUC_MEAN = Measure(
    "auc_mean",
    "AUC\n/image",
    "Mean of the AUCs of single pictures.",
    lambda part: part.image_auc,
    interval=True,
    shown=("screen", "further", "pairs"),
)

IOU = Measure(
    "iou",
    "IoU",
    "Overlap of decided and true road, at the chosen threshold.",
    _of_chosen(metrics.iou),
    interval=True,
    shown=("screen", "screen pairs", "scores", "pairs"),
)

F = Measure(
    "f",
    "F",
    "F at the chosen threshold.",
    _of_chosen(metrics.f_measure),
    interval=True,
    shown=("further",),
)

F_MASK = Measure(
    "f_mask",
    "F\nof mask",
    "F of the detector's own mask, at its default threshold: what a user gets.",
    _of_mask(metrics.f_measure),
    interval=True,
    shown=("headline", "parts", "screen pairs", "pairs"),
)

IOU_MASK = Measure(
    "iou_mask",
    "IoU\nof mask",
    "Overlap of the detector's own mask, as it ships.",
    _of_mask(metrics.iou),
    interval=True,
    shown=("headline", "parts"),
)

SCORES = (
    Measure(
        "images",
        "pictures",
        "Pictures that were scored.",
        _of_pictures(lambda pictures: len(pictures.names)),
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
        "threshold\nof MaxF",
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
        shown=("screen", "screen pairs", "scores", "pairs"),
    ),
    AUC_MEAN,
    Measure(
        "auc_images_skipped",
        "skipped",
        "Pictures without road or without background, which have no AUC.",
        _of_pictures(lambda pictures: int(pictures.auc.isnan().sum())),
        better=None,
        digits=0,
        over_groups="whole",
    ),
    Measure(
        "auc_vertical",
        "AUC,\nvertical",
        "Area under the mean of the single pictures' ROC curves, at equal false positive rates.",
        _of_roc(curves.area),
    ),
    Measure(
        "ap",
        "AP",
        "Best precision at recall 0, 0.1, … 1 or above, averaged (KITTI).",
        _of_road(metrics.average_precision),
        interval=True,
        shown=("screen", "scores", "pairs"),
    ),
    IOU,
    Measure(
        "eer",
        "EER",
        "Error rate where false positives and misses are as many.",
        _of_road(lambda counts: curves.equal_error_rate(curves.operating_points(counts))),
        better="lower",
        interval=True,
        shown=("screen", "scores"),
    ),
    Measure(
        "eer_vertical",
        "EER,\nvertical",
        "Error rate of the mean of the single pictures' ROC curves.",
        _of_roc(curves.equal_error_rate),
        better="lower",
    ),
    Measure(
        "brier",
        "Brier",
        "Mean squared distance of likelihood and truth.",
        _of_road(curves.brier),
        better="lower",
        interval=True,
        shown=("screen", "scores", "pairs"),
    ),
    Measure(
        "ms_per_image",
        "ms\n/image",
        "Median time of one picture, detector alone.",
        _of_pictures(lambda pictures: 1000 * statistics.median(pictures.seconds.tolist())),
        better=None,
        digits=1,
        over_groups="whole",
        shown=("screen", "scores"),
    ),
    Measure(
        "ece",
        "ECE",
        "Mean distance of the likelihood and the share of road that really has it.",
        _of_road(curves.expected_error),
        better="lower",
        shown=("screen", "further", "parts"),
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
        shown=("further",),
    ),
    F,
    Measure(
        "precision",
        "precision",
        "Share of true road in what is decided to be road.",
        _of_chosen(metrics.precision),
        shown=("further",),
    ),
    Measure(
        "recall",
        "recall",
        "Share of the true road that is found.",
        _of_chosen(metrics.recall),
        shown=("further",),
    ),
    Measure(
        "precision_mask",
        "precision\nof mask",
        "Precision of that mask.",
        _of_mask(metrics.precision),
        shown=("parts",),
    ),
    Measure(
        "recall_mask",
        "recall\nof mask",
        "Recall of that mask.",
        _of_mask(metrics.recall),
        shown=("parts",),
    ),
)


def _border(place: int, share: float) -> Measure:
    return Measure(
        f"boundary_f/{share:g}",
        f"border F\n{100 * share:g} %",
        "F of borders: decided and true ones count as met within this share of the diagonal.",
        lambda part: boundary.boundary_f(part.boundary[..., place, :]),
        shown=("further", "parts") if share == boundary.THREE_PIXELS else ("further",),
    )


BORDERS = tuple(_border(*pair) for pair in enumerate(boundary.TOLERANCES))


def _at_max_f(key: str, name: str, meaning: str, **more: Any) -> Measure:
    """A figure at KITTI's working point; more: further fields of the measure."""
    formula: Formula = lambda part: part.working_point[key]  # noqa: E731
    return Measure(f"working_point/{key}", name, meaning, formula, over_groups="nothing", **more)


WORKING_POINT = (
    _at_max_f("level", "level", "Level of likelihood where F is highest (KITTI).", better=None),
    _at_max_f("precision", "PRE", "Precision where F is highest (KITTI).", shown=("further",)),
    _at_max_f("recall", "REC", "Recall there.", shown=("further",)),
    _at_max_f("fpr", "FPR", "False positive rate there.", better="lower", shown=("further",)),
    _at_max_f("fnr", "FNR", "False negative rate there.", better="lower", shown=("further",)),
    _at_max_f("accuracy", "accuracy", "Share of pixels that are right there."),
    _at_max_f("quality", "quality", "Overlap of decided and true road there."),
)

# --- the layout: under each reading of void, of potentials and of labels that may abstain -----

VOID = ", void counted as vertical"
LABELLED = ", where the labeller does not abstain"


def _layout(
    key: str, name: str, meaning: str, figure: Callable[[Tensor], Tensor], **more: Any
) -> Measure:
    """A figure of the confusion that the key names; more: further fields of the measure."""
    of_labels, void_is_vertical = key.startswith("labelled"), "void_as_vertical" in key

    def formula(part: Part) -> Tensor | None:
        confusion = part.labels if of_labels else part.layout
        if confusion is None:
            return None
        return figure(metrics.void_as_vertical(confusion) if void_is_vertical else confusion)

    return Measure(f"layout/{key}", name, meaning, formula, **more)


def _recalls(under: str, words: str, **more: Any) -> list[Measure]:
    """The recall of each class."""
    return [
        _layout(
            f"{under}{name}",
            name,
            f"Share of {name} that is found{words}.",
            lambda confusion, place=place: metrics.class_recalls(confusion)[..., place],
            **more,
        )
        for place, name in enumerate(NAMES)
    ]


def _mean_recall(under: str, name: str, words: str, **more: Any) -> Measure:
    meaning = f"Mean of the three{words}."
    return _layout(f"{under}mean", name, meaning, metrics.mean_class_recall, **more)


def _confusion(truth: int, decided: int) -> Measure:
    true, other = NAMES[truth], NAMES[decided]
    return _layout(
        f"confusion/{true}/{other}",
        f"{true} as\n{other}",
        f"Share of {true} that is decided to be {other}.",
        lambda confusion: metrics.normalised_confusion(confusion)[..., truth, decided],
        better=None,
    )


LAYOUT = (
    *_recalls("", "", shown=("layout",)),
    _mean_recall("", "mean", "", interval=True, shown=("layout", "pairs")),
    _layout(
        "accuracy",
        "accuracy",
        "Share of all pixels that are right.",
        metrics.layout_accuracy,
        shown=("layout",),
    ),
    *(_confusion(truth, decided) for truth in range(CLASSES) for decided in range(CLASSES)),
    *_recalls("void_as_vertical/", VOID),
    _mean_recall("void_as_vertical/", "mean, void\nvertical", VOID, shown=("layout",)),
    *_recalls("labelled/", LABELLED),
    _mean_recall("labelled/", "mean,\nlabelled", LABELLED, shown=("layout",)),
    *_recalls("labelled/void_as_vertical/", LABELLED + VOID),
    _mean_recall("labelled/void_as_vertical/", "mean,\nlabelled, void\nvertical", LABELLED + VOID),
    _layout(
        "labelled_share",
        "labelled\nshare",
        "Share of pixels with a label.",
        metrics.labelled_share,
        shown=("layout",),
    ),
)


MEASURES: tuple[Measure, ...] = (
    *SCORES,
    *DECISIONS,
    *BORDERS,
    *WORKING_POINT,
    *TRUST,
    *LAYOUT,
)
"""All measures, in the order in which files and tables have them."""
