"""Choose the threshold of a detector on labelled images, and report what the choice gains."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from roadtorch.base.errors import DatasetError
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.detectors.detector import DetectorSettings
from roadtorch.evaluation.measure import Figures
from roadtorch.evaluation.measures import IOU, F
from roadtorch.evaluation.report.table import Cell, Table, share
from roadtorch.evaluation.result import Evaluation, summarise

DIGITS = 3  # of a threshold in a config


@dataclass(frozen=True)
class ThresholdChoice:
    """The threshold that was chosen for one detector, and its figures.

    settings: with the chosen threshold; default: the threshold until now. at_default, chosen:
    F and IoU at both, on the very images that chose; held_out: each group at the threshold of
    the others, nothing without groups.
    """

    detector: str
    settings: DetectorSettings
    default: float
    images: float
    at_default: Figures
    chosen: Figures
    held_out: Figures


def choose_threshold(
    evaluation: Evaluation, name: str, settings: Mapping[str, Any]
) -> ThresholdChoice:
    """Choose the threshold with the highest F, averaged over groups, to three digits.

    settings: those that the run gave to the detector. Raises DatasetError when no image
    shows road.
    """
    figures = evaluation.detectors[name]
    if math.isnan(figures.best_threshold):
        raise DatasetError(evaluation.dataset.root, "shows no road", "give pictures with road")
    entry, tally = detector_entry(name), evaluation.tallies[name]
    tuned = entry.configured({**settings, "threshold": round(figures.best_threshold, DIGITS)})
    default = entry.configured({}).threshold
    at_default, chosen = (
        summarise(
            replace(figures.contender, chosen=threshold), tally, (F, IOU), evaluation.left_out
        ).headline
        for threshold in (default, tuned.threshold)
    )
    held_out = figures.headline if len(figures.groups) > 1 else {}
    images = figures.headline["images"]
    return ThresholdChoice(name, tuned, default, images, at_default, chosen, held_out)


def choice_table(choices: Sequence[ThresholdChoice]) -> Table:
    """Return F at the default threshold, the chosen one, and F and IoU there and held out."""
    table = Table("detector", [choice.detector for choice in choices])
    for header, values in {
        "default": [choice.default for choice in choices],
        "F at default": [F.of(choice.at_default) for choice in choices],
        "threshold": [choice.settings.threshold for choice in choices],
        "F": [F.of(choice.chosen) for choice in choices],
        "IoU": [IOU.of(choice.chosen) for choice in choices],
        "F held out": [F.of(choice.held_out) for choice in choices],
        "IoU held out": [IOU.of(choice.held_out) for choice in choices],
    }.items():
        table.add(header, [Cell(share(value)) for value in values])
    return table


def provenance(choice: ThresholdChoice, evaluation: Evaluation, command: str) -> list[str]:
    """Return lines for a config: where its threshold comes from, and what it gains."""

    def both(figures: Figures) -> str:
        return f"F {F.of(figures):.3f}, IoU {IOU.of(figures):.3f}"

    dataset = evaluation.dataset
    lines = [
        f"The threshold is chosen on {dataset.name} {dataset.split}, {choice.images} pictures, by",
        f"  {command}",
        f"At the default threshold {choice.default:.3f}: F {F.of(choice.at_default):.3f}.",
        f"On these pictures: {both(choice.chosen)} (mean over the groups).",
    ]
    if choice.held_out:
        lines.append(f"Each group at the threshold of the others: {both(choice.held_out)}.")
    return lines
