"""What a run and a choice of thresholds say on the screen."""

import math
from collections.abc import Sequence

from roadtorch.evaluation.measures import MAXF
from roadtorch.evaluation.result import Evaluation
from roadtorch.evaluation.thresholds import DIGITS, ThresholdChoice
from roadtorch.report.table import Cell, Table, share, table_text
from roadtorch.report.tables import (
    MAX_COLUMNS,
    MAX_SHOWN,
    condition_rows,
    differences,
    group_rows,
    part_table,
    recalls,
    scores,
    trust,
)

MAX_TOLD = 3
"""Detectors that are told by group and by condition, the best."""

MAX_ROWS = 20
"""Rows of such a table."""


def screen(evaluation: Evaluation) -> str:
    """The tables of a run: road, then what there is of groups, conditions, trust, layout, pairs."""
    shown = shortlist(evaluation)
    best_first = sorted(shown, key=lambda name: -_maxf(evaluation, name))
    told = [name for name in best_first if not evaluation.detectors[name].is_baseline][:MAX_TOLD]
    by_group = len(evaluation.groups) > MAX_COLUMNS["screen"] or evaluation.left_out
    against = evaluation.comparison.against
    tables = [
        table_text(scores(evaluation, best_first, "screen"), "detector"),
        *(_part_text(evaluation, name, "group") for name in told if by_group),
        *(_part_text(evaluation, name, "condition") for name in told if evaluation.conditions),
        table_text(trust(evaluation, best_first), "trust"),
        _layout_text(evaluation, shown),
        table_text(differences(evaluation, shown, "screen pairs"), f"minus {against}"),
    ]
    if more := len(evaluation.detectors) - len(shown):
        tables.append(f"{more} more detectors, with lower MaxF, are in metrics.json (--out DIR)")
    return "\n\n".join(filter(None, tables))


def shortlist(evaluation: Evaluation) -> list[str]:
    """The baselines and the best of the others by MaxF, in the order in which they stand."""
    detectors = evaluation.detectors
    others = [name for name, one in detectors.items() if not one.is_baseline]
    best = sorted(others, key=lambda name: -_maxf(evaluation, name))[:MAX_SHOWN]
    return [name for name, one in detectors.items() if one.is_baseline or name in best]


def _maxf(evaluation: Evaluation, name: str) -> float:
    """That of the headline, to be sorted by: the lowest of all where there is none."""
    value = MAXF.of(evaluation.detectors[name].headline)
    return -math.inf if math.isnan(value) else value


def _part_text(evaluation: Evaluation, name: str, kind: str) -> str:
    """The figures of one detector's groups or conditions; of very many the worst, and the rest."""
    rows = (group_rows if kind == "group" else condition_rows)(evaluation, name)
    text = table_text(part_table(evaluation, name, rows, MAX_ROWS), f"{name} by {kind}")
    more = len(rows.counting) - MAX_ROWS
    return text + (f"\n{more} more are in metrics.json (--out DIR)" if more > 0 else "")


def _layout_text(evaluation: Evaluation, names: Sequence[str]) -> str:
    """Class recalls of the detectors that label the layout, by group; empty if none does."""
    rows = [
        (name, group, figures)
        for name in names
        for one in [evaluation.detectors[name]]
        for group, figures in (*sorted(one.groups.items()), ("mean", one.headline))
        if any(measure.key in figures for measure in evaluation.shown_in("layout"))
    ]
    wide, narrow = (max(map(len, [title, *(row[i] for row in rows)]))
                    for i, title in enumerate(("layout", "group")))  # fmt: skip
    parts = {f"{name:{wide}}  {group:>{narrow}}": figures for name, group, figures in rows}
    return table_text(recalls(evaluation, parts), f"{'layout':{wide}}  {'group':>{narrow}}")


# --- thresholds that were chosen --------------------------------------------------------


def choice_text(choices: Sequence[ThresholdChoice]) -> str:
    """Detector, chosen threshold, F and IoU there and held out; before them the default's F."""
    table = Table([one.detector for one in choices])
    for header, values in {
        "default": [f"{one.default:.{DIGITS}f}" for one in choices],
        "F at default": [share(one.f_default) for one in choices],
        "threshold": [f"{one.threshold:.{DIGITS}f}" for one in choices],
        "F": [share(one.f) for one in choices],
        "IoU": [share(one.iou) for one in choices],
        "F held out": [share(one.f_held_out) for one in choices],
        "IoU held out": [share(one.iou_held_out) for one in choices],
    }.items():
        table.add(header, "", map(Cell, values))
    return table_text(table, "detector")


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
