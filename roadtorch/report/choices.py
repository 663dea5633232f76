"""Thresholds that were chosen: a table for the screen, and the record in a config."""

import math
from collections.abc import Sequence

from roadtorch.evaluation.result import Evaluation
from roadtorch.evaluation.thresholds import DIGITS, ThresholdChoice
from roadtorch.report.screen import NONE, align


def choice_table(choices: Sequence[ThresholdChoice]) -> str:
    """Detector, chosen threshold, F and IoU there and held out; before them the default's F."""
    header = ["detector", "default", "F at default", "threshold"]
    header += ["F", "IoU", "F held out", "IoU held out"]
    rows = [
        [
            one.detector,
            f"{one.default:.{DIGITS}f}",
            _figure(one.f_default),
            f"{one.threshold:.{DIGITS}f}",
            *map(_figure, (one.f, one.iou, one.f_held_out, one.iou_held_out)),
        ]
        for one in choices
    ]
    return align([header, *rows])


def _figure(value: float) -> str:
    return NONE if math.isnan(value) else f"{value:.3f}"


def provenance(choice: ThresholdChoice, evaluation: Evaluation, command: str) -> list[str]:
    """Where a threshold comes from and what it is worth, as lines for its config."""
    dataset = evaluation.dataset
    lines = [
        f"The threshold is chosen on {dataset.name} {dataset.split}, {choice.images} pictures, by",
        f"  {command}",
        f"At the default threshold {choice.default:.{DIGITS}f}: F {choice.f_default:.3f}.",
        f"On these pictures: F {choice.f:.3f}, IoU {choice.iou:.3f} (mean over the groups).",
    ]
    if math.isnan(choice.f_held_out):
        return lines
    held_out = f"F {choice.f_held_out:.3f}, IoU {choice.iou_held_out:.3f}"
    return [*lines, f"Each group at the threshold of the others: {held_out}."]
