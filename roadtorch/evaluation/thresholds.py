"""Thresholds that labels choose: the best on average, and for each drive that of the others."""

import math
from collections.abc import Collection, Mapping

import torch

from roadtorch.evaluation import metrics
from roadtorch.evaluation.metrics import RoadCounts


def shared_threshold(groups: Mapping[str, RoadCounts]) -> float:
    """The threshold with the highest F, averaged over drives; the lowest of equals.

    NaN when no drive has road.
    """
    found = [metrics.f_curve(counts) for counts in groups.values() if counts.road.sum() > 0]
    return float(metrics.best_threshold(torch.stack(found).mean(0))[1]) if found else math.nan


def held_out_thresholds(groups: Mapping[str, RoadCounts]) -> dict[str, float]:
    """For every drive the threshold that the other drives choose; it never sees its own."""
    return {
        group: shared_threshold({name: groups[name] for name in groups if name != group})
        for group in groups
    }


def choose_thresholds(
    groups: Mapping[str, RoadCounts],
    default: float,
    given: float | None,
    left_out: Collection[str] = (),
) -> tuple[str, dict[str, float]]:
    """Where the thresholds come from, in words, and one for every drive.

    left_out: drives that choose for nobody.
    """
    if given is not None:
        return "an earlier run", dict.fromkeys(groups, given)
    choosing = {group: counts for group, counts in groups.items() if group not in left_out}
    if len(choosing) > 1:
        found = held_out_thresholds(choosing)
        shared = shared_threshold(choosing)
        return "the other drives", {group: found.get(group, shared) for group in groups}
    return "the detector's default", dict.fromkeys(groups, default)
