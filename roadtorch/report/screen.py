"""The tables of a run on the screen."""

import math
from collections.abc import Mapping, Sequence

from roadtorch.evaluation.measure import Figures, Measure
from roadtorch.evaluation.measures import F_MASK, MAXF
from roadtorch.evaluation.result import DetectorFigures, Difference, Evaluation
from roadtorch.report.parts import PartRow, condition_rows, group_rows

NONE = "-"

WORST = (F_MASK, MAXF)
"""Of many groups, the worst by these measures has a column."""

MOST_SHOWN = 40
"""Detectors on the screen, besides the baselines; a grid of 310 fills no screen well."""


def screen(evaluation: Evaluation) -> str:
    """The tables of a run: road, then what there is of groups, conditions, trust, layout, pairs."""
    detectors = shortlist(evaluation)
    tables = [
        road_table(evaluation, detectors),
        *group_tables(evaluation, detectors),
        *condition_tables(evaluation, detectors),
        trust_table(evaluation, detectors),
        layout_table(evaluation, detectors),
        pair_table(evaluation, detectors),
    ]
    if more := len(evaluation.detectors) - len(detectors):
        tables.append(f"{more} more detectors, with lower MaxF, are in metrics.json (--out DIR)")
    return "\n\n".join(filter(None, tables))


def shortlist(evaluation: Evaluation) -> dict[str, DetectorFigures]:
    """The baselines and the best of the others by MaxF, in the order in which they stand."""
    detectors = evaluation.detectors
    best = [name for name in _best_first(detectors) if not detectors[name].is_baseline][:MOST_SHOWN]
    return {name: one for name, one in detectors.items() if one.is_baseline or name in best}


def _best_first(detectors: Mapping[str, DetectorFigures]) -> list[str]:
    """Names by MaxF, equal ones as they stand, those without one last."""
    scores = {name: MAXF.of(one.headline) for name, one in detectors.items()}
    return sorted(scores, key=lambda name: math.inf if math.isnan(scores[name]) else -scores[name])


MAX_GROUPS = 6
"""Groups with a column of their own; of more, the worst is told."""


def road_table(evaluation: Evaluation, detectors: Mapping[str, DetectorFigures]) -> str:
    """What a user gets beside MaxF, then the other figures; best MaxF first.

    MaxF has a column for each group; of more than ``MAX_GROUPS`` the worst is told, by MaxF
    and by F of the mask.
    """
    first, measures = evaluation.shown_in("headline"), evaluation.shown_in("screen")
    many = len(evaluation.groups) > MAX_GROUPS
    groups = [] if many else evaluation.groups
    pooled = ["pooled"] if evaluation.groups else []
    by_group = [f"MaxF {group}" for group in groups]
    worst = [f"worst {one.line}" for one in WORST if many]
    header = ["detector", *by_group, *(one.line for one in first), "95 %", *worst, *pooled]
    header += [one.line for one in measures]
    rows = [header]
    for name in _best_first(detectors):
        one = detectors[name]
        low, high = one.interval
        rows.append([
            name,
            *(MAXF.text(MAXF.of(one.group(group)), NONE) for group in groups),
            *(measure.text(measure.of(one.headline), NONE) for measure in first),
            f"{MAXF.text(low, NONE)}–{MAXF.text(high, NONE)}",
            *(worst_group(one, measure) for measure in WORST if many),
            *(MAXF.text(MAXF.of(one.pooled), NONE) for _ in pooled),
            *(measure.text(measure.of(one.headline), NONE) for measure in measures),
        ])  # fmt: skip
    return align(rows)


MOST_TOLD = 3
"""Detectors that are told by group and by condition, the best."""

MOST_ROWS = 20
"""Rows of such a table."""


def group_tables(evaluation: Evaluation, detectors: Mapping[str, DetectorFigures]) -> list[str]:
    """The groups of the best detectors, worst first, where they have no columns or are left out."""
    if len(evaluation.groups) <= MAX_GROUPS and not evaluation.left_out:
        return []
    measures = evaluation.shown_in("parts")
    rows = {name: group_rows(evaluation, name) for name in _told(detectors)}
    return [part_text(f"{name} by group", rows[name], measures) for name in rows]


def condition_tables(evaluation: Evaluation, detectors: Mapping[str, DetectorFigures]) -> list[str]:
    """The conditions of the best detectors, worst first; nothing where none is known."""
    if not evaluation.conditions:
        return []
    measures = evaluation.shown_in("parts")
    rows = {name: condition_rows(evaluation, name) for name in _told(detectors)}
    return [part_text(f"{name} by condition", rows[name], measures) for name in rows]


def _told(detectors: Mapping[str, DetectorFigures]) -> list[str]:
    return [name for name in _best_first(detectors) if not detectors[name].is_baseline][:MOST_TOLD]


def part_text(title: str, rows: Sequence[PartRow], measures: Sequence[Measure]) -> str:
    """The figures of one detector's groups or conditions; of very many the worst, and the rest."""
    counting = [row for row in rows if row.counts]
    shown = [*counting[:MOST_ROWS], *(row for row in rows if not row.counts)]
    known = [one for one in measures if any(one.key in row.figures for row in rows)]
    table = [[title, *(one.line for one in known), "MaxF of baseline"]]
    table += [
        [
            row.name,
            *(one.text(one.of(row.figures), NONE) for one in known),
            MAXF.text(row.baseline, NONE),
        ]
        for row in shown
    ]
    more = len(counting) - MOST_ROWS
    return align(table) + (f"\n{more} more are in metrics.json (--out DIR)" if more > 0 else "")


def trust_table(evaluation: Evaluation, detectors: Mapping[str, DetectorFigures]) -> str:
    """A line for each detector that has trust: how well it tells good masks from bad ones."""
    measures = evaluation.shown_in("trust")
    rows = [
        [name, *(one.text(one.of(detectors[name].headline), NONE) for one in measures)]
        for name in _best_first(detectors)
        if any(one.key in detectors[name].headline for one in measures)
    ]
    return align([["trust", *(one.line for one in measures)], *rows]) if rows else ""


def worst_group(one: DetectorFigures, measure: Measure) -> str:
    """The lowest value among the groups, and whose it is."""
    values = {group: measure.of(figures) for group, figures in one.groups.items()}
    known = {group: value for group, value in values.items() if not math.isnan(value)}
    if not known:
        return NONE
    group = min(known, key=lambda name: known[name])
    return f"{measure.text(known[group], NONE)} {group}"


def layout_table(evaluation: Evaluation, detectors: Mapping[str, DetectorFigures]) -> str:
    """Class recalls of the detectors that label the layout, by group; empty if none does."""
    measures = evaluation.shown_in("layout")
    header = ["layout", "group", *(one.line for one in measures)]
    rows = [
        [name, group, *(measure.text(measure.of(figures), NONE) for measure in measures)]
        for name, one in detectors.items()
        for group, figures in _with_mean(one).items()
        if any(measure.key in figures for measure in measures)
    ]
    return align([header, *rows]) if rows else ""


def _with_mean(one: DetectorFigures) -> dict[str, Figures]:
    return {**dict(sorted(one.groups.items())), "mean": one.headline}


def pair_table(evaluation: Evaluation, detectors: Mapping[str, DetectorFigures]) -> str:
    """Each detector minus the one it is compared with, with 95 % intervals; empty for one."""
    comparison, measures = evaluation.comparison, evaluation.shown_in("screen pairs")
    header = [f"minus {comparison.against}"]
    header += [text for one in measures for text in (one.line, "95 %")]
    rows = [
        [name, *(text for one in measures for text in _change(changes[one.key]))]
        for name, changes in comparison.differences.items()
        if name in detectors
    ]
    return align([header, *rows]) if rows else ""


def _change(change: Difference) -> tuple[str, str]:
    ends = change.interval
    signed = [NONE if math.isnan(part) else f"{part:+.3f}" for part in (change.value, *ends)]
    return signed[0], f"{signed[1]} to {signed[2]}"


def align(rows: Sequence[Sequence[str]]) -> str:
    """Rows of text in columns: the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        first, *rest = (
            cell.rjust(width) if index else cell.ljust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        lines.append("  ".join([first, *rest]).rstrip())
    return "\n".join(lines)
