"""What a run and a choice of thresholds say on the screen."""

import math
from collections.abc import Sequence

from roadtorch.evaluation.evaluate import ThresholdChoice
from roadtorch.evaluation.measure import Figures
from roadtorch.evaluation.measures import F_MASK, IOU, IOU_MASK, MAXF, F
from roadtorch.evaluation.report.table import Cell, Table, share, signed, table_text
from roadtorch.evaluation.report.tables import (
    MAX_COLUMNS,
    MAX_SHOWN,
    Kind,
    add_recalls,
    best_baseline,
    differences,
    part_table,
    scores,
    trust,
)
from roadtorch.evaluation.result import DetectorFigures, Evaluation, Interval

MAX_TOLD = 3
"""Detectors that are told by group and by condition, the best."""

MAX_ROWS = 20
"""Rows of such a table."""


def screen(evaluation: Evaluation) -> str:
    """The tables of a run: road, then what there is of groups, conditions, trust, layout, pairs."""
    shown = shortlist(evaluation)
    best_first = [name for name in evaluation.ranked() if name in shown]
    best = [name for name in best_first if not evaluation.detectors[name].is_baseline][:MAX_TOLD]
    by_group = len(evaluation.groups) > MAX_COLUMNS["screen"] or evaluation.left_out
    against = evaluation.comparison.against
    tables = [
        table_text(scores(evaluation, best_first, "screen"), "detector"),
        *(_part_text(evaluation, name, "group") for name in best if by_group),
        *(_part_text(evaluation, name, "condition") for name in best if evaluation.conditions),
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
    best = [name for name in evaluation.ranked() if not detectors[name].is_baseline][:MAX_SHOWN]
    return [name for name, figures in detectors.items() if figures.is_baseline or name in best]


def _part_text(evaluation: Evaluation, name: str, kind: Kind) -> str:
    """The figures of one detector's groups or conditions; of very many the worst, and the rest."""
    text = table_text(part_table(evaluation, name, kind, MAX_ROWS), f"{name} by {kind}")
    more = len(evaluation.groups if kind == "group" else evaluation.conditions) - MAX_ROWS
    return text + (f"\n{more} more are in metrics.json (--out DIR)" if more > 0 else "")


def _layout_text(evaluation: Evaluation, names: Sequence[str]) -> str:
    """Class recalls of the detectors that label the layout, by group; empty if none does."""
    keys = {measure.key for measure in evaluation.shown_in("layout")}
    rows = {
        (name, group): figures
        for name in names
        for detector in [evaluation.detectors[name]]
        for group, figures in (*sorted(detector.groups.items()), ("mean", detector.headline))
        if keys & figures.keys()
    }
    table = Table([name for name, _ in rows])
    table.add("group", "", [Cell(group) for _, group in rows])
    add_recalls(table, evaluation, rows.values())
    return table_text(table, "layout")


# --- thresholds that were chosen --------------------------------------------------------


def choice_text(choices: Sequence[ThresholdChoice]) -> str:
    """Detector, chosen threshold, F and IoU there and held out; before them the default's F."""
    table = Table([choice.detector for choice in choices])
    for header, values in {
        "default": [choice.default for choice in choices],
        "F at default": [F.of(choice.at_default) for choice in choices],
        "threshold": [choice.settings.threshold for choice in choices],
        "F": [F.of(choice.chosen) for choice in choices],
        "IoU": [IOU.of(choice.chosen) for choice in choices],
        "F held out": [F.of(choice.held_out) for choice in choices],
        "IoU held out": [IOU.of(choice.held_out) for choice in choices],
    }.items():
        table.add(header, "", [Cell(share(value)) for value in values])
    return table_text(table, "detector")


def provenance(choice: ThresholdChoice, evaluation: Evaluation, command: str) -> list[str]:
    """Where a threshold comes from and what it is worth, as lines for its config."""

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


def outcome(evaluation: Evaluation) -> list[str]:
    """The best detector against the best baseline; how far the groups differ; how sure it is."""
    detectors = evaluation.detectors
    scores = MAXF.known(evaluation.headlines)
    baseline, level = best_baseline(evaluation, evaluation.headlines)
    scored = [n for n in evaluation.ranked() if n in scores and not detectors[n].is_baseline]
    if not scored:
        if not baseline:
            return ["No detector has a score."]
        alone = f"the best is {baseline} with a MaxF of {share(level)}"
        return [f"Only blind baselines were scored; {alone}."]
    best = scored[0]
    sentences = [_first(best, detectors[best], baseline, level), *_mask(detectors[best])]
    if baseline and (ends := paired_interval(evaluation, best, baseline)):
        sentences.append(f"The distance to {baseline} has a 95 % interval of {_range(*ends)}.")
    sentences += _groups(best, evaluation)
    if len(scored) > 1:
        second = scored[1]
        ends = paired_interval(evaluation, best, second)
        interval = f" (95 % interval {_range(*ends)})" if ends else ""
        behind = share(scores[best] - scores[second])
        sentences.append(f"Next is {second}, {behind} behind{interval}.")
    return sentences + _decided(best, detectors[best])


def _first(name: str, figures: DetectorFigures, baseline: str, level: float) -> str:
    """How far the best detector is above the best baseline, whose MaxF is ``level``."""
    score, ends = MAXF.of(figures.headline), figures.interval
    interval = f" (95 % interval {share(ends.low)} to {share(ends.high)})" if ends.is_known else ""
    text, distance = f"{name} is best: MaxF {share(score)}{interval}", score - level
    if not baseline:
        return f"{text}. No blind baseline was scored beside it."
    if round(distance, 3) <= 0:
        text = f"No detector is above the blind baselines: {name} has a MaxF of {share(score)}"
        return f"{text}{interval}, {share(-distance)} below {baseline} ({share(level)})."
    return f"{text}, {share(distance)} above the best blind baseline, {baseline} ({share(level)})."


def _mask(figures: DetectorFigures) -> list[str]:
    """What a user gets, with no label to choose a threshold, and where that is worst."""
    f, overlap = F_MASK.of(figures.headline), IOU_MASK.of(figures.headline)
    if math.isnan(f) or math.isnan(overlap):
        return []
    text = (
        f"Its mask at the default threshold has an F of {share(f)} and an IoU of {share(overlap)}"
    )
    known = F_MASK.known(figures.groups)
    if len(known) < 2:
        return [f"{text}."]
    low = min(known, key=known.__getitem__)
    return [f"{text}; on the worst of {len(known)} groups, {low}, an F of {share(known[low])}."]


def _groups(name: str, evaluation: Evaluation) -> list[str]:
    """The worst and the best group, and on how many the detector is above the baselines."""
    scores = MAXF.known(evaluation.detectors[name].groups)
    if len(scores) < 2:
        return []
    low, high = min(scores, key=scores.__getitem__), max(scores, key=scores.__getitem__)
    text = f"By group from {share(scores[low])} ({low}) to {share(scores[high])} ({high})"
    levels = {group: best_baseline(evaluation, evaluation.of_group(group))[1] for group in scores}
    compared = [group for group, level in levels.items() if not math.isnan(level)]
    if not compared:
        return [f"{text}."]
    above = sum(scores[group] > levels[group] for group in compared)
    return [f"{text}; above every blind baseline on {above} of {len(compared)} groups."]


def paired_interval(evaluation: Evaluation, first: str, second: str) -> Interval | None:
    """The interval of one detector's MaxF less that of another, if the run compared them."""
    comparison = evaluation.comparison
    for name, against, sign in ((first, second, 1), (second, first, -1)):
        change = comparison.differences.get(name, {}).get(MAXF.key)
        if comparison.against == against and change and change.interval.is_known:
            return Interval(*sorted(sign * end for end in change.interval))
    return None


def _range(low: float, high: float) -> str:
    """An interval in words; one that has 0 inside tells nothing apart."""
    apart = "" if low > 0 or high < 0 else ", which these pictures do not tell from 0"
    return f"{signed(low)} to {signed(high)}{apart}"


def _decided(name: str, figures: DetectorFigures) -> list[str]:
    """MaxF flatters; what is left of it when the threshold comes from elsewhere."""
    f, overlap = F.of(figures.headline), IOU.of(figures.headline)
    if math.isnan(f) or math.isnan(overlap):
        return []
    origin = f", from {figures.threshold_from}," if figures.threshold_from else ""
    return [
        f"MaxF picks its threshold on the labels it is scored on; at the chosen threshold{origin} "
        f"{name} has an F of {share(f)} and an IoU of {share(overlap)}."
    ]
