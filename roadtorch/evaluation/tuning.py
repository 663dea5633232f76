"""A detector's threshold, chosen on development pictures, and what the choice is worth."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from roadtorch.detectors.catalogue import detector_entry
from roadtorch.errors import DatasetError
from roadtorch.evaluation import metrics
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.parts import mean
from roadtorch.evaluation.result import Evaluation
from roadtorch.evaluation.thresholds import held_out_thresholds
from roadtorch.settings import Settings, build_settings

DIGITS = 3  # of a threshold in a config


@dataclass(frozen=True)
class ThresholdChoice:
    """What was chosen for one detector, and how it does.

    default: the threshold until now. f_default: mean over the drives there.
    f, iou: mean over the drives at the chosen threshold, which these very pictures chose.
    f_held_out, iou_held_out: each drive at the threshold of the others, NaN without drives.
    """

    detector: str
    settings: Settings
    threshold: float
    default: float
    f_default: float
    images: int
    f: float
    iou: float
    f_held_out: float
    iou_held_out: float


def choose_threshold(
    evaluation: Evaluation, name: str, settings: Mapping[str, Any]
) -> ThresholdChoice:
    """Choose the threshold with the highest F, averaged over drives, to three digits.

    settings: those that the run gave to the detector. Raises DatasetError when no picture
    shows road.
    """
    tally = evaluation.tallies[name]
    groups = {group: tally.road[group] for group in evaluation.detectors[name].counting}
    best = evaluation.detectors[name].best_threshold
    if math.isnan(best):
        raise DatasetError(evaluation.dataset.root, "shows no road", "give pictures with road")
    threshold = round(best, DIGITS)
    kind = detector_entry(name).settings
    default: float = kind().model_dump()["threshold"]
    held_out = held_out_thresholds(groups) if len(groups) > 1 else {}
    return ThresholdChoice(
        name,
        build_settings(kind, {**settings, "threshold": threshold}),
        threshold,
        default,
        _mean_figures(groups, dict.fromkeys(groups, default))[0],
        sum(group in groups for _, group in tally.pictures),
        *_mean_figures(groups, dict.fromkeys(groups, threshold)),
        *_mean_figures(groups, held_out),
    )


def _mean_figures(
    groups: Mapping[str, RoadCounts], thresholds: Mapping[str, float]
) -> tuple[float, float]:
    """F and IoU at each drive's threshold, averaged over the drives with road; NaN without any."""
    outcomes = [
        metrics.decisions_at(groups[group], threshold)
        for group, threshold in thresholds.items()
        if not math.isnan(threshold) and groups[group].road.sum() > 0
    ]
    return (
        mean([float(metrics.f_measure(one)) for one in outcomes]),
        mean([float(metrics.iou(one)) for one in outcomes]),
    )
