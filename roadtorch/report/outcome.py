"""What a run says, in sentences made from its numbers."""

import math
from collections.abc import Mapping

from roadtorch.evaluation.measure import Figures, Measure
from roadtorch.evaluation.measures import F_MASK, IOU, IOU_MASK, MAXF, F
from roadtorch.evaluation.result import DetectorFigures, Evaluation, Interval
from roadtorch.report.table import share, signed
from roadtorch.report.tables import best_baseline


def outcome(evaluation: Evaluation) -> list[str]:
    """The best detector against the best baseline; how far the groups differ; how sure it is."""
    detectors = evaluation.detectors
    scores = {name: MAXF.of(detectors[name].headline) for name in evaluation.ranked()}
    baseline, level = best_baseline(evaluation, {n: detectors[n].headline for n in scores})
    scored = [n for n, v in scores.items() if not math.isnan(v) and not detectors[n].is_baseline]
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
    known = _known(F_MASK, figures.groups)
    if len(known) < 2:
        return [f"{text}."]
    low = min(known, key=known.__getitem__)
    return [f"{text}; on the worst of {len(known)} groups, {low}, an F of {share(known[low])}."]


def _groups(name: str, evaluation: Evaluation) -> list[str]:
    """The worst and the best group, and on how many the detector is above the baselines."""
    scores = _known(MAXF, evaluation.detectors[name].groups)
    if len(scores) < 2:
        return []
    low, high = min(scores, key=scores.__getitem__), max(scores, key=scores.__getitem__)
    text = f"By group from {share(scores[low])} ({low}) to {share(scores[high])} ({high})"
    levels = {
        group: best_baseline(
            evaluation, {each: one.group(group) for each, one in evaluation.detectors.items()}
        )[1]
        for group in scores
    }
    compared = [group for group, level in levels.items() if not math.isnan(level)]
    if not compared:
        return [f"{text}."]
    above = sum(scores[group] > levels[group] for group in compared)
    return [f"{text}; above every blind baseline on {above} of {len(compared)} groups."]


def _known(measure: Measure, parts: Mapping[str, Figures]) -> dict[str, float]:
    """The values of a measure by group, where they are defined."""
    values = {group: measure.of(figures) for group, figures in parts.items()}
    return {group: value for group, value in values.items() if not math.isnan(value)}


def paired_interval(evaluation: Evaluation, one: str, other: str) -> Interval | None:
    """The interval of one detector's MaxF less that of another, if the run compared them."""
    comparison = evaluation.comparison
    for name, against, sign in ((one, other, 1), (other, one, -1)):
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
