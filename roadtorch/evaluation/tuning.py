"""Choose the threshold of a detector on labelled images, and report the gain."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from roadtorch.base.errors import DatasetError
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.detectors.entry import DetectorSettings
from roadtorch.evaluation.measure import Scores
from roadtorch.evaluation.measures import IOU, F
from roadtorch.evaluation.methods import Contender
from roadtorch.evaluation.report.table import Cell, Table, format_number
from roadtorch.evaluation.result import Evaluation, summarise


@dataclass(frozen=True)
class ThresholdChoice:
    """A chosen threshold and its scores."""

    contender: Contender
    settings: DetectorSettings  # with the chosen threshold
    images: float
    at_default: Scores  # F and IoU at the previous threshold, on the images that chose
    chosen: Scores  # F and IoU at the chosen threshold, on the same images
    held_out: Scores  # F and IoU of each group at the threshold of the others; empty without groups


def tune_thresholds(evaluation: Evaluation) -> list[ThresholdChoice]:
    """Choose the threshold of every detector of the catalogue but the baselines."""
    return [
        tune_threshold(evaluation, name)
        for name, scores in evaluation.detectors.items()
        if scores.contender.detector and not scores.is_baseline
    ]


def tune_threshold(evaluation: Evaluation, name: str) -> ThresholdChoice:
    """Choose the threshold of the highest F averaged over groups; DatasetError without road."""
    scores, tally = evaluation.detectors[name], evaluation.tallies[name]
    contender = scores.contender
    if math.isnan(scores.best_threshold):
        raise DatasetError(evaluation.dataset.root, "shows no road", "give images with road")
    best = {"threshold": round(scores.best_threshold, 5)}
    tuned = detector_entry(contender.detector).make_settings({**contender.settings, **best})
    default, chosen = (
        summarise(
            replace(contender, earlier_threshold=threshold), tally, (F, IOU), evaluation.left_out
        ).headline
        for threshold in (contender.threshold, tuned.threshold)
    )
    is_held_out = contender.earlier_threshold is None and len(scores.groups) > 1
    held_out = scores.headline if is_held_out else {}
    return ThresholdChoice(contender, tuned, scores.headline["images"], default, chosen, held_out)


def choice_table(choices: Sequence[ThresholdChoice]) -> Table:
    """Return a table of F at the default threshold, and of F and IoU at the chosen one."""
    table = Table("detector", [choice.contender.name for choice in choices])
    for header, values in {
        "default": [choice.contender.threshold for choice in choices],
        "F at default": [F.get(choice.at_default) for choice in choices],
        "threshold": [choice.settings.threshold for choice in choices],
        "F": [F.get(choice.chosen) for choice in choices],
        "IoU": [IOU.get(choice.chosen) for choice in choices],
        "F held out": [F.get(choice.held_out) for choice in choices],
        "IoU held out": [IOU.get(choice.held_out) for choice in choices],
    }.items():
        table.add(header, [Cell(format_number(value)) for value in values])
    return table


def tuned_file(contender: Contender) -> str:
    """Return the name of the config with a contender's chosen threshold."""
    return f"{contender.name.replace(':', '-')}.toml"


def provenance(choice: ThresholdChoice, evaluation: Evaluation, command: str) -> str:
    """Return comment lines for a config: the origin of its threshold, and the gain."""

    def describe(scores: Scores) -> str:
        return f"F {F.get(scores):.3f}, IoU {IOU.get(scores):.3f}"

    dataset = evaluation.dataset
    lines = [
        f"The threshold is chosen on {dataset.name} {dataset.split}, {choice.images} images, by",
        f"  {command}",
        f"At the default threshold {choice.contender.threshold:.3f}: "
        f"F {F.get(choice.at_default):.3f}.",
        f"On these images: {describe(choice.chosen)} (mean over the groups).",
    ]
    if choice.held_out:
        lines.append(f"Each group at the threshold of the others: {describe(choice.held_out)}.")
    return "".join(f"# {line}\n" for line in lines)
