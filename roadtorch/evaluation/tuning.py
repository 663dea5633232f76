"""A detector's threshold, chosen on development pictures and written down with its worth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from roadtorch.data.dataset import Dataset
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.errors import DatasetError
from roadtorch.evaluation import metrics
from roadtorch.evaluation.runner import Plan
from roadtorch.evaluation.summary import held_out_thresholds, shared_threshold
from roadtorch.evaluation.tally import Tally
from roadtorch.report.screen import align
from roadtorch.settings import Settings, build_settings

DIGITS = 3  # of a threshold in a config


@dataclass(frozen=True)
class Choice:
    """What was chosen for one detector, and how it does.

    f, iou: mean over the drives at the chosen threshold, which these very pictures chose.
    f_held_out, iou_held_out: each drive at the threshold of the others, NaN without drives.
    """

    detector: str
    settings: Settings
    images: int
    f: float
    iou: float
    f_held_out: float
    iou_held_out: float


def choose(name: str, plan: Plan, tally: Tally) -> Choice:
    """Choose the threshold with the highest F, averaged over drives, to three digits.

    Raises DatasetError when no picture shows road.
    """
    best = shared_threshold(tally.road)
    if math.isnan(best):
        raise DatasetError(plan.dataset.root, "shows no road", "give pictures with road")
    threshold = round(best, DIGITS)
    shared = dict.fromkeys(tally.road, threshold)
    held_out = held_out_thresholds(tally.road) if len(tally.road) > 1 else {}
    values: dict[str, Any] = {**plan.detectors[name], "threshold": threshold}
    return Choice(
        name,
        build_settings(detector_entry(name).settings, values),
        len(tally.pictures),
        *_mean_figures(tally, shared),
        *_mean_figures(tally, held_out),
    )


def _mean_figures(tally: Tally, thresholds: dict[str, float]) -> tuple[float, float]:
    """F and IoU at each drive's threshold, meaned over drives with road; NaN without any."""
    outcomes = [
        metrics.decisions_at(tally.road[group], threshold)
        for group, threshold in thresholds.items()
        if not math.isnan(threshold) and tally.road[group].road.sum() > 0
    ]
    if not outcomes:
        return math.nan, math.nan
    f = sum(float(metrics.f_measure(one)) for one in outcomes) / len(outcomes)
    return f, sum(float(metrics.iou(one)) for one in outcomes) / len(outcomes)


def provenance(choice: Choice, dataset: Dataset, command: str) -> list[str]:
    """Where the threshold comes from and what it is worth, as lines for the config."""
    lines = [
        f"The threshold is chosen on {dataset.name} {dataset.split}, {choice.images} pictures, by",
        f"  {command}",
        f"On these pictures: F {choice.f:.3f}, IoU {choice.iou:.3f} (mean over the drives).",
    ]
    if math.isnan(choice.f_held_out):
        return lines
    held_out = f"F {choice.f_held_out:.3f}, IoU {choice.iou_held_out:.3f}"
    return [*lines, f"Each drive at the threshold of the others: {held_out}."]


def table(choices: Sequence[Choice]) -> str:
    """Detector, chosen threshold, the default until now, F and IoU, chosen here and held out."""
    header = ["detector", "threshold", "default", "F", "IoU", "F held out", "IoU held out"]
    rows = [
        [
            choice.detector,
            f"{_threshold(choice.settings):.{DIGITS}f}",
            f"{_threshold(detector_entry(choice.detector).settings()):.{DIGITS}f}",
            *(
                "-" if math.isnan(value) else f"{value:.3f}"
                for value in (choice.f, choice.iou, choice.f_held_out, choice.iou_held_out)
            ),
        ]
        for choice in choices
    ]
    return align([header, *rows])


def _threshold(settings: Settings) -> float:
    return settings.model_dump()["threshold"]
