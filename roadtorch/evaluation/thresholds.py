"""Thresholds that labels choose: the best on average, and for each group that of the others."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch

from roadtorch.detectors.catalogue import detector_entry
from roadtorch.errors import DatasetError
from roadtorch.evaluation import metrics
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.result import Evaluation
from roadtorch.settings import Settings

DIGITS = 3  # of a threshold in a config


def shared_threshold(groups: Mapping[str, RoadCounts]) -> float:
    """The threshold with the highest F, averaged over groups; the lowest of equals.

    NaN when no group has road.
    """
    known = [metrics.f_curve(counts) for counts in groups.values() if counts.road.sum() > 0]
    return float(metrics.best_threshold(torch.stack(known).mean(0))[1]) if known else math.nan


def held_out_thresholds(groups: Mapping[str, RoadCounts]) -> dict[str, float]:
    """For every group the threshold that the other groups choose; it never sees its own."""
    return {
        group: shared_threshold({name: groups[name] for name in groups if name != group})
        for group in groups
    }


class Thresholds(NamedTuple):
    """Where they come from, in words; one for every group; the best of all groups that choose."""

    source: str
    thresholds: Mapping[str, float]
    best: float


def choose_thresholds(
    groups: Mapping[str, RoadCounts],
    default: float,
    given: float | None,
    left_out: Collection[str] = (),
) -> Thresholds:
    """The thresholds of all groups: given, those of the others, or the detector's default.

    left_out: groups that choose for nobody.
    """
    choosing = {group: counts for group, counts in groups.items() if group not in left_out}
    best = shared_threshold(choosing)
    if given is not None:
        return Thresholds("an earlier run", dict.fromkeys(groups, given), best)
    if len(choosing) > 1:
        held_out = held_out_thresholds(choosing)
        by_group = {group: held_out.get(group, best) for group in groups}
        return Thresholds("the other groups", by_group, best)
    return Thresholds("the detector's default", dict.fromkeys(groups, default), best)


# --- the threshold of a config -----------------------------------------------------------


@dataclass(frozen=True)
class ThresholdChoice:
    """What was chosen for one detector, and how it does.

    default: the threshold until now. f_default: mean over the groups there.
    f, iou: mean over the groups at the chosen threshold, which these very pictures chose.
    f_held_out, iou_held_out: each group at the threshold of the others, NaN without groups.
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
    """Choose the threshold with the highest F, averaged over groups, to three digits.

    settings: those that the run gave to the detector. Raises DatasetError when no picture
    shows road.
    """
    tally = evaluation.tallies[name]
    groups = {group: tally.road[group] for group in evaluation.detectors[name].counting}
    best = evaluation.detectors[name].best_threshold
    if math.isnan(best):
        raise DatasetError(evaluation.dataset.root, "shows no road", "give pictures with road")
    threshold = round(best, DIGITS)
    entry = detector_entry(name)
    default = entry.configured({}).threshold
    held_out = held_out_thresholds(groups) if len(groups) > 1 else {}
    return ThresholdChoice(
        name,
        entry.configured({**settings, "threshold": threshold}),
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
    """F and IoU at each group's threshold, averaged over the groups with road; NaN without any."""
    outcomes = [
        metrics.decisions_at(groups[group], threshold)
        for group, threshold in thresholds.items()
        if not math.isnan(threshold) and groups[group].road.sum() > 0
    ]
    if not outcomes:
        return math.nan, math.nan
    f, iou = ([float(of(one)) for one in outcomes] for of in (metrics.f_measure, metrics.iou))
    return sum(f) / len(f), sum(iou) / len(iou)
