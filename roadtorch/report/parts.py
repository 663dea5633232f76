"""Groups and conditions of one detector, the worst first: rows for the screen and the page."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from roadtorch.evaluation.measure import Figures
from roadtorch.evaluation.measures import F_MASK, MAXF
from roadtorch.evaluation.result import Evaluation


@dataclass(frozen=True)
class PartRow:
    """One group or condition, or what stands below them.

    baseline: MaxF of the best baseline there, NaN without any. counts: whether it is one of those
    among which the worst is looked for.
    """

    name: str
    figures: Figures
    baseline: float
    counts: bool = True


def group_rows(evaluation: Evaluation, name: str) -> list[PartRow]:
    """The groups by F of the mask, the lowest first, then their mean and those left out."""
    detectors = evaluation.detectors
    if not detectors[name].groups:
        return []
    groups = {
        group: {each: one.group(group) for each, one in detectors.items()}
        for group in (*evaluation.groups, *evaluation.left_out)
    }
    mean = {each: one.headline for each, one in detectors.items()}
    return [
        *_worst_first([_row(evaluation, name, one, groups[one]) for one in evaluation.groups]),
        _row(evaluation, name, "mean", mean, counts=False),
        *(
            _row(evaluation, name, f"{one} (left out)", groups[one], counts=False)
            for one in evaluation.left_out
        ),
    ]


def condition_rows(evaluation: Evaluation, name: str) -> list[PartRow]:
    """The conditions by F of the mask, the lowest first, with the number of their groups."""
    items = evaluation.dataset.by_condition()
    rows = []
    for condition in evaluation.conditions:
        parts = {
            each: one.conditions.get(condition, {}) for each, one in evaluation.detectors.items()
        }
        groups = len({item.group for item in items[condition]} - {None})
        of = f" ({groups} group{'' if groups == 1 else 's'})" if groups else ""
        rows.append(_row(evaluation, name, condition + of, parts))
    return _worst_first(rows)


def _row(
    evaluation: Evaluation,
    name: str,
    label: str,
    parts: Mapping[str, Figures],
    counts: bool = True,
) -> PartRow:
    """The row of a detector; parts: the figures of all detectors there."""
    baseline = best_baseline(
        evaluation, {each: MAXF.of(figures) for each, figures in parts.items()}
    )
    return PartRow(label, parts[name], baseline[1] if baseline else math.nan, counts)


def _worst_first(rows: Sequence[PartRow]) -> list[PartRow]:
    """By F of the mask, those without one last."""
    known = [row for row in rows if not math.isnan(F_MASK.of(row.figures))]
    return [
        *sorted(known, key=lambda row: F_MASK.of(row.figures)),
        *(row for row in rows if row not in known),
    ]


def best_baseline(evaluation: Evaluation, values: Mapping[str, float]) -> tuple[str, float] | None:
    """The baseline with the highest of some values."""
    baselines = [
        (name, value)
        for name, value in values.items()
        if evaluation.detectors[name].is_baseline and not math.isnan(value)
    ]
    return max(baselines, key=lambda pair: pair[1]) if baselines else None
