"""What a run found, in sentences made from its numbers."""

import math
from collections.abc import Mapping

from roadtorch.evaluation.measures import F_MASK, IOU, IOU_MASK, MAXF, F
from roadtorch.evaluation.result import DetectorFigures, Evaluation, Interval
from roadtorch.report.page.tables import share, signed
from roadtorch.report.parts import best_baseline


def outcome(evaluation: Evaluation) -> list[str]:
    """The best detector against the best baseline; how far the groups differ; how sure it is."""
    detectors = evaluation.detectors
    scores = {name: MAXF.of(detectors[name].headline) for name in evaluation.ranked()}
    baseline = best_baseline(evaluation, scores)
    scored = [n for n, v in scores.items() if not math.isnan(v) and not detectors[n].is_baseline]
    if not scored:
        return ["No detector has a score." if baseline is None else _baseline_alone(*baseline)]
    best = scored[0]
    sentences = [_first(best, scores[best], detectors[best], baseline)]
    sentences += _mask(detectors[best])
    sentences += _pair(best, baseline, evaluation) + _groups(best, evaluation)
    if len(scored) > 1:
        sentences.append(_next(best, scored[1], scores, evaluation))
    return sentences + _decided(best, detectors[best])


def _baseline_alone(name: str, score: float) -> str:
    return f"Only blind baselines were scored; the best is {name} with a MaxF of {share(score)}."


def _first(
    name: str, score: float, figures: DetectorFigures, baseline: tuple[str, float] | None
) -> str:
    ends = figures.interval
    interval = f" (95 % interval {share(ends.low)} to {share(ends.high)})" if ends.is_known else ""
    text = f"{name} is best: MaxF {share(score)}{interval}"
    if baseline is None:
        return f"{text}. No blind baseline was scored beside it."
    distance = score - baseline[1]
    if round(distance, 3) <= 0:
        text = f"No detector is above the blind baselines: {name} has a MaxF of {share(score)}"
        text += interval
        return f"{text}, {share(-distance)} below {baseline[0]} ({share(baseline[1])})."
    name, score = baseline
    return f"{text}, {share(distance)} above the best blind baseline, {name} ({share(score)})."


def _mask(figures: DetectorFigures) -> list[str]:
    """What a user gets, with no label to choose a threshold, and where that is worst."""
    f, overlap = F_MASK.of(figures.headline), IOU_MASK.of(figures.headline)
    if math.isnan(f) or math.isnan(overlap):
        return []
    text = (
        f"Its mask at the default threshold has an F of {share(f)} and an IoU of {share(overlap)}"
    )
    found = {group: F_MASK.of(part) for group, part in figures.groups.items()}
    known = {group: value for group, value in found.items() if not math.isnan(value)}
    if len(known) < 2:
        return [f"{text}."]
    low = min(known, key=known.__getitem__)
    return [f"{text}; on the worst of {len(known)} groups, {low}, an F of {share(known[low])}."]


def _groups(name: str, evaluation: Evaluation) -> list[str]:
    """The worst and the best group, and on how many the detector is above the baselines."""
    groups = evaluation.detectors[name].groups
    known = {group: MAXF.of(figures) for group, figures in groups.items()}
    scores = {group: value for group, value in known.items() if not math.isnan(value)}
    if len(scores) < 2:
        return []
    low, high = min(scores, key=scores.__getitem__), max(scores, key=scores.__getitem__)
    text = f"By group from {share(scores[low])} ({low}) to {share(scores[high])} ({high})"
    baselines = {group: _baseline_of_group(group, evaluation) for group in scores}
    compared = {group: value for group, value in baselines.items() if value is not None}
    if not compared:
        return [f"{text}."]
    above = sum(scores[group] > value for group, value in compared.items())
    return [f"{text}; above every blind baseline on {above} of {len(compared)} groups."]


def _baseline_of_group(group: str, evaluation: Evaluation) -> float | None:
    scores = {name: MAXF.of(one.group(group)) for name, one in evaluation.detectors.items()}
    found = best_baseline(evaluation, scores)
    return found[1] if found else None


def paired_interval(evaluation: Evaluation, one: str, other: str) -> Interval | None:
    """The interval of one detector's MaxF less that of another, if the run compared them."""
    comparison = evaluation.comparison
    for name, against, sign in ((one, other, 1), (other, one, -1)):
        change = comparison.differences.get(name, {}).get(MAXF.key)
        if comparison.against == against and change and change.interval.is_known:
            return Interval(*sorted(sign * end for end in change.interval))
    return None


def _pair(best: str, baseline: tuple[str, float] | None, evaluation: Evaluation) -> list[str]:
    """How sure the distance to the baseline is."""
    ends = paired_interval(evaluation, best, baseline[0]) if baseline else None
    if baseline is None or ends is None:
        return []
    return [f"The distance to {baseline[0]} has a 95 % interval of {_range(*ends)}."]


def _next(best: str, second: str, scores: Mapping[str, float], evaluation: Evaluation) -> str:
    """The detector that comes second."""
    ends = paired_interval(evaluation, best, second)
    interval = f" (95 % interval {_range(*ends)})" if ends else ""
    return f"Next is {second}, {share(scores[best] - scores[second])} behind{interval}."


def _range(low: float, high: float) -> str:
    """An interval in words; one that has 0 inside tells nothing apart."""
    apart = "" if low > 0 or high < 0 else ", which these pictures do not tell from 0"
    return f"{signed(low)} to {signed(high)}{apart}"


def _decided(name: str, figures: DetectorFigures) -> list[str]:
    """MaxF flatters; what is left of it when the threshold comes from elsewhere."""
    f, overlap = F.of(figures.headline), IOU.of(figures.headline)
    if math.isnan(f) or math.isnan(overlap):
        return []
    source = figures.threshold_from
    origin = f", from {source}," if source else ""
    return [
        f"MaxF picks its threshold on the labels it is scored on; at the chosen threshold{origin} "
        f"{name} has an F of {share(f)} and an IoU of {share(overlap)}."
    ]
