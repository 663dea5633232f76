"""Choose the threshold of a detector on labelled images, and report what the choice gains."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from roadtorch.base.errors import DatasetError
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.detectors.detector import DetectorSettings
from roadtorch.evaluation.measure import Figures
from roadtorch.evaluation.measures import IOU, F
from roadtorch.evaluation.methods import Contender
from roadtorch.evaluation.report.table import Cell, Table, share
from roadtorch.evaluation.result import Evaluation, summarise

DIGITS = 3  # of a threshold in a config


@dataclass(frozen=True)
class ThresholdChoice:
    """The threshold that was chosen for one detector, and its figures.

    settings: with the chosen threshold. at_default, chosen: F and IoU at the threshold until now
    and at the chosen one, on the very images that chose; held_out: each group at the threshold of
    the others, nothing without groups.
    """

    contender: Contender
    settings: DetectorSettings
    images: float
    at_default: Figures
    chosen: Figures
    held_out: Figures


def tune_thresholds(evaluation: Evaluation) -> list[ThresholdChoice]:
    """Choose the threshold of every detector of the catalogue but the baselines."""
    return [
        tune_threshold(evaluation, name)
        for name, figures in evaluation.detectors.items()
        if figures.contender.detector and not figures.is_baseline
    ]


def tune_threshold(evaluation: Evaluation, name: str) -> ThresholdChoice:
    """Choose the threshold with the highest F, averaged over groups, to three digits.

    Raises DatasetError when no image shows road.
    """
    figures, tally = evaluation.detectors[name], evaluation.tallies[name]
    contender = figures.contender
    if math.isnan(figures.best_threshold):
        raise DatasetError(evaluation.dataset.root, "shows no road", "give images with road")
    best = {"threshold": round(figures.best_threshold, DIGITS)}
    tuned = detector_entry(contender.detector).configured({**contender.settings, **best})
    at_default, chosen = (
        summarise(
            replace(contender, chosen=threshold), tally, (F, IOU), evaluation.left_out
        ).headline
        for threshold in (contender.threshold, tuned.threshold)
    )
    held_out = figures.headline if len(figures.groups) > 1 else {}
    return ThresholdChoice(
        contender, tuned, figures.headline["images"], at_default, chosen, held_out
    )


def choice_table(choices: Sequence[ThresholdChoice]) -> Table:
    """Return F at the default threshold, the chosen one, and F and IoU there and held out."""
    table = Table("detector", [choice.contender.name for choice in choices])
    for header, values in {
        "default": [choice.contender.threshold for choice in choices],
        "F at default": [F.of(choice.at_default) for choice in choices],
        "threshold": [choice.settings.threshold for choice in choices],
        "F": [F.of(choice.chosen) for choice in choices],
        "IoU": [IOU.of(choice.chosen) for choice in choices],
        "F held out": [F.of(choice.held_out) for choice in choices],
        "IoU held out": [IOU.of(choice.held_out) for choice in choices],
    }.items():
        table.add(header, [Cell(share(value)) for value in values])
    return table


def provenance(choice: ThresholdChoice, evaluation: Evaluation, command: str) -> str:
    """Return comment lines for a config: where its threshold comes from, and what it gains."""

    def both(figures: Figures) -> str:
        return f"F {F.of(figures):.3f}, IoU {IOU.of(figures):.3f}"

    dataset = evaluation.dataset
    lines = [
        f"The threshold is chosen on {dataset.name} {dataset.split}, {choice.images} images, by",
        f"  {command}",
        f"At the default threshold {choice.contender.threshold:.3f}: "
        f"F {F.of(choice.at_default):.3f}.",
        f"On these images: {both(choice.chosen)} (mean over the groups).",
    ]
    if choice.held_out:
        lines.append(f"Each group at the threshold of the others: {both(choice.held_out)}.")
    return "".join(f"# {line}\n" for line in lines)
