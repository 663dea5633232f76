"""Tables of an evaluation, for the screen, tables.md and the report."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal, get_args

from roadtorch.evaluation.measure import UNDEFINED, Scores
from roadtorch.evaluation.measures import F_MASK, MAXF
from roadtorch.evaluation.report.table import Cell, Table, format_number, format_signed
from roadtorch.evaluation.result import Difference, Evaluation

SCREEN_WIDTH = 100  # letters in a line of the screen
MAX_LISTED = 40  # detectors beside the baselines; a grid has 310
MAX_GROUP_COLUMNS = 6  # groups with a column of their own
MAX_PART_TABLES = 3  # best detectors with a table by group and one by condition
MAX_SCREEN_ROWS = 20  # rows of such a table on the screen

INTERVAL, BASELINE_HEADER = "95 %", "MaxF of baseline"

PartKind = Literal["group", "condition"]


def format_tables(evaluation: Evaluation) -> str:
    """Return the tables of an evaluation as text, with the columns that fit ``SCREEN_WIDTH``."""
    scored = f"{evaluation.images} of {len(evaluation.dataset.items)} images were scored"
    texts = [scored] if evaluation.failures else []
    texts += [table.text(SCREEN_WIDTH) for table in build_tables(evaluation, MAX_SCREEN_ROWS)]
    if more := len(evaluation.detectors) - len(shortlist(evaluation)):
        texts.append(f"{more} more detectors, with lower MaxF: metrics.json (--out DIR)")
    return "\n\n".join(texts)


def build_tables(evaluation: Evaluation, limit: int | None = None) -> list[Table]:
    """Return the tables: road, then groups, conditions, trust, layout and differences, if any.

    limit: rows of tables by group or condition; then groups that are columns have no table.
    """
    listed = shortlist(evaluation)
    ranked = [name for name in evaluation.ranking() if name in listed]
    best = [name for name in ranked if not evaluation.detectors[name].is_baseline][:MAX_PART_TABLES]
    has_columns = len(evaluation.groups) <= MAX_GROUP_COLUMNS and not evaluation.left_out
    tables = [
        score_table(evaluation, ranked),
        *(
            part_table(evaluation, name, part, limit)
            for part in get_args(PartKind)
            for name in best
            if limit is None or part == "condition" or not has_columns
        ),
        trust_table(evaluation, ranked),
        layout_table(evaluation, listed, limit),
        difference_table(evaluation, listed),
    ]
    return [table for table in tables if table.names]


def shortlist(evaluation: Evaluation) -> list[str]:
    """Return the baselines and the best other detectors by MaxF, in the order of the run."""
    detectors = evaluation.detectors
    best = [name for name in evaluation.ranking() if not detectors[name].is_baseline][:MAX_LISTED]
    return [name for name, scores in detectors.items() if scores.is_baseline or name in best]


def baseline_names(evaluation: Evaluation) -> set[str]:
    """Return the detectors that ignore the image."""
    return {name for name, scores in evaluation.detectors.items() if scores.is_baseline}


def score_table(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """Return the scores of detectors: MaxF of a few groups, or the worst of many, then the means.

    With groups there is also MaxF of all pixels pooled.
    """
    detectors, groups = evaluation.detectors, evaluation.groups
    headline = evaluation.measures_in("headline")
    required = {INTERVAL, *(measure.name for measure in headline)}
    table = Table("detector", names, baseline_names(evaluation), required=required)
    has_columns = len(groups) <= MAX_GROUP_COLUMNS
    parts = [detectors[name].headline for name in names]
    for group in groups if has_columns else ():
        table.add_measure(MAXF, [detectors[name].group(group) for name in names], f"MaxF {group}")
    for measure in headline:
        table.add_measure(measure, parts)
    table.add(INTERVAL, (Cell(str(detectors[name].interval)) for name in names))
    for measure in () if has_columns else (F_MASK, MAXF):
        cells = []
        for values in (measure.get_defined(detectors[name].groups) for name in names):
            group = min(values, key=values.__getitem__, default=None)
            text = UNDEFINED if group is None else f"{measure.format(values[group])} {group}"
            cells.append(Cell(text))
        table.add(f"worst {measure.name}", cells)
    if groups:
        table.add_measure(MAXF, [detectors[name].pooled for name in names], "pooled")
    for measure in evaluation.measures_in("scores"):
        table.add_measure(measure, parts)
    return table


def trust_table(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """Return the measures of trust, of the detectors that have it."""
    measures = evaluation.measures_in("trust")
    parts = {name: evaluation.detectors[name].headline for name in names}
    keys = {measure.key for measure in measures}
    parts = {name: scores for name, scores in parts.items() if keys & scores.keys()}
    table = Table("trust", list(parts))
    for measure in measures:
        table.add_measure(measure, parts.values())
    return table


def layout_table(evaluation: Evaluation, names: Sequence[str], limit: int | None = None) -> Table:
    """Return class recalls of layouts by group, or above ``limit`` rows their means alone."""
    measures = evaluation.measures_in("layout")
    keys = {measure.key for measure in measures}
    rows = {
        (name, group): scores
        for name in names
        for detector in [evaluation.detectors[name]]
        for group, scores in (*sorted(detector.groups.items()), ("mean", detector.headline))
        if keys & scores.keys()
    }
    is_long = limit is not None and len(rows) > limit
    listed = {key: scores for key, scores in rows.items() if not is_long or key[1] == "mean"}
    table = Table("layout", [name for name, _ in listed], omitted=len(rows) - len(listed))
    table.add("group", [Cell(group) for _, group in listed])
    for measure in measures:
        table.add_measure(measure, listed.values(), is_ranked=False)
    return table


def difference_table(evaluation: Evaluation, names: Sequence[str]) -> Table:
    """Return differences to one detector with intervals, bold where these exclude 0."""
    comparison = evaluation.comparison
    names = [name for name in names if name in comparison.differences]
    table = Table(f"minus {comparison.against}", names, baseline_names(evaluation))
    for measure in evaluation.measures_in("pairs"):
        changes = [comparison.differences[name].get(measure.key) for name in names]
        if any(changes):
            table.add(measure.name, map(_difference_cell, changes))
    return table


def _difference_cell(change: Difference | None) -> Cell:
    if change is None:
        return Cell(UNDEFINED)
    low, high = change.interval
    note = f"{format_signed(low)} to {format_signed(high)}" if change.interval.is_defined else ""
    return Cell(format_signed(change.value), bool(change.interval.sign), note)


# --- groups and conditions of one detector ----------------------------------------------


def part_table(
    evaluation: Evaluation, name: str, part: PartKind, limit: int | None = None
) -> Table:
    """Return one detector's groups or conditions by F of its mask, the lowest first.

    Below the groups are their mean and those left out; conditions are followed by the number of
    their groups. The last column is the best baseline's MaxF. limit: maximum number of rows.
    """
    parts = _conditions(evaluation)
    if part == "group":
        parts = {group: evaluation.group_scores(group) for group in evaluation.groups}
    defined = F_MASK.get_defined({label: scores[name] for label, scores in parts.items()})
    worst_first = sorted(parts, key=lambda label: defined.get(label, math.inf))[:limit]
    rows = {label: parts[label] for label in worst_first}
    if part == "group" and rows:
        rows["mean"] = evaluation.headlines
        rows |= {f"{g} (left out)": evaluation.group_scores(g) for g in evaluation.left_out}
    required = {BASELINE_HEADER, *(measure.name for measure in evaluation.measures_in("headline"))}
    omitted = len(parts) - len(worst_first)
    table = Table(f"{name} by {part}", list(rows), omitted=omitted, required=required)
    for measure in evaluation.measures_in("parts"):
        table.add_measure(measure, [scores[name] for scores in rows.values()], is_ranked=False)
    baselines = (best_baseline_maxf(evaluation, scores) for scores in rows.values())
    table.add(BASELINE_HEADER, (Cell(format_number(maxf)) for maxf in baselines))
    return table


def best_baseline_maxf(evaluation: Evaluation, parts: Mapping[str, Scores]) -> float:
    """Return the highest MaxF of the baselines in scores by detector; NaN without any."""
    names = baseline_names(evaluation) & parts.keys()
    return max(MAXF.get_defined({name: parts[name] for name in names}).values(), default=math.nan)


def _conditions(evaluation: Evaluation) -> dict[str, dict[str, Scores]]:
    """Return the scores of all detectors by condition, its name with the number of its groups."""
    items, parts = evaluation.dataset.items_by_condition(), {}
    for condition in evaluation.conditions:
        groups = len({item.group for item in items[condition]} - {None})
        of = f" ({groups} group{'' if groups == 1 else 's'})" if groups else ""
        parts[condition + of] = {
            name: scores.conditions.get(condition, {})
            for name, scores in evaluation.detectors.items()
        }
    return parts
