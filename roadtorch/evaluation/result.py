"""Result of an evaluation: scores by detector and group, from counts at chosen thresholds."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.evaluation import metrics
from roadtorch.evaluation.measure import UNDEFINED, Measure, Scores, TableName
from roadtorch.evaluation.measures import MAXF, MEASURES
from roadtorch.evaluation.methods import Contender
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.tally import UNGROUPED, ImageTable, PooledCounts, Tally, pool


class Interval(NamedTuple):
    """Ends of a 95 % interval; NaN where no replicate has a value."""

    low: float = math.nan
    high: float = math.nan

    @property
    def is_defined(self) -> bool:
        """Return whether both ends are defined."""
        return not math.isnan(self.low) and not math.isnan(self.high)

    @property
    def sign(self) -> int:
        """1 where the interval lies above 0, -1 below it, else 0."""
        return (self.low > 0) - (self.high < 0)

    def __str__(self) -> str:
        """Return both ends with three decimals."""
        return f"{self.low:.3f}–{self.high:.3f}" if self.is_defined else UNDEFINED


@dataclass(frozen=True)
class DetectorScores:
    """Scores of one detector.

    headline: means over the groups, or the scores of a set without groups. pooled: of the summed
    counts of all groups; without groups it and ``groups`` are empty. left_out: groups that count in
    none of these. conditions: of each condition's images, pooled, from 8-bit maps.
    thresholds: chosen for each group (for ``UNGROUPED`` without groups); threshold_from: their
    origin, in words. best_threshold: the one with the highest F, averaged over the groups.
    intervals: of the headline scores, by the key of the measure.
    """

    contender: Contender
    headline: Scores
    groups: Mapping[str, Scores] = field(default_factory=dict)
    pooled: Scores = field(default_factory=dict)
    left_out: Mapping[str, Scores] = field(default_factory=dict)
    conditions: Mapping[str, Scores] = field(default_factory=dict)
    thresholds: Mapping[str, float] = field(default_factory=dict)
    threshold_from: str = ""
    best_threshold: float = math.nan
    intervals: Mapping[str, Interval] = field(default_factory=dict)

    @property
    def interval(self) -> Interval:
        """Interval of MaxF."""
        return self.intervals.get(MAXF.key, Interval())

    @property
    def ranking_score(self) -> float:
        """MaxF, to rank detectors by; -inf where it is undefined."""
        return -math.inf if math.isnan(maxf := MAXF.get(self.headline)) else maxf

    @property
    def counted_groups(self) -> list[str]:
        """Groups that count in the means: all but those left out; ``UNGROUPED`` without groups."""
        return list(self.groups) or [UNGROUPED]

    @property
    def is_baseline(self) -> bool:
        """Return whether the detector ignores the image."""
        return self.contender.is_baseline

    def group(self, name: str) -> Scores:
        """Return the scores of one group, left out or not; empty for an unknown group."""
        return self.groups.get(name, self.left_out.get(name, {}))


@dataclass(frozen=True)
class Difference:
    """Difference of a score to that of another detector, with its 95 % interval."""

    value: float
    interval: Interval

    def __str__(self) -> str:
        """Return it with its interval, signed."""
        low, high = self.interval
        return f"{self.value:+.3f} (95 % {low:+.3f} to {high:+.3f})"


@dataclass(frozen=True)
class Comparison:
    """Differences of all detectors to the one called ``against``, by detector and measure's key."""

    against: str
    differences: Mapping[str, Mapping[str, Difference]]


@dataclass(frozen=True)
class Failure:
    """An image that could not be scored, and so counts for no detector."""

    image: str
    group: str | None
    reason: str


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Result of an evaluation: the set, the scores by detector, and the images that failed.

    tallies: counts by detector, from which the scores are computed. measures: those of the scores,
    in the order of the tables.
    """

    dataset: Dataset
    detectors: Mapping[str, DetectorScores]
    comparison: Comparison
    failures: Sequence[Failure] = ()
    tallies: Mapping[str, Tally] = field(default_factory=dict, repr=False)
    measures: Sequence[Measure] = field(default=MEASURES, repr=False)

    @property
    def headlines(self) -> dict[str, Scores]:
        """Headline scores by detector."""
        return {name: scores.headline for name, scores in self.detectors.items()}

    def group_scores(self, group: str) -> dict[str, Scores]:
        """Return the scores of one group by detector."""
        return {name: scores.group(group) for name, scores in self.detectors.items()}

    @property
    def images(self) -> int:
        """Number of images that were scored."""
        return len(self.dataset.items) - len(self.failures)

    @property
    def groups(self) -> list[str]:
        """Groups that count and that any detector has scores of, sorted."""
        return sorted({group for scores in self.detectors.values() for group in scores.groups})

    @property
    def conditions(self) -> list[str]:
        """Conditions that any detector has scores of, sorted."""
        return sorted({name for scores in self.detectors.values() for name in scores.conditions})

    @property
    def left_out(self) -> list[str]:
        """Groups that have scores but count in no mean, sorted."""
        return sorted({group for scores in self.detectors.values() for group in scores.left_out})

    def ranking(self) -> list[str]:
        """Return the detectors by MaxF, highest first; those without one last, then by name."""
        return sorted(self.detectors, key=lambda name: (-self.detectors[name].ranking_score, name))

    def measures_in(self, *tables: TableName) -> list[Measure]:
        """Return the measures that are columns of any of these tables."""
        return [measure for measure in self.measures if set(tables) & set(measure.tables)]


# --- thresholds that labels choose ------------------------------------------------------


def shared_threshold(groups: Mapping[str, RoadCounts]) -> float:
    """Return the lowest threshold with the highest F, averaged over groups; NaN without road."""
    curves = [metrics.f_curve(counts) for counts in groups.values() if counts.road.sum() > 0]
    return float(metrics.best_threshold(torch.stack(curves).mean(0))[1]) if curves else math.nan


def held_out_thresholds(groups: Mapping[str, RoadCounts]) -> dict[str, float]:
    """Return for each group the threshold that the other groups choose."""
    return {
        group: shared_threshold({name: groups[name] for name in groups if name != group})
        for group in groups
    }


def choose_thresholds(
    contender: Contender, groups: Mapping[str, RoadCounts], left_out: Collection[str] = ()
) -> tuple[str, Mapping[str, float], float]:
    """Choose a threshold for every group: of an earlier run, of the other groups, or the default.

    groups: pixels by level of each group. left_out: groups that have no part in the choice.

    Returns:
        Origin of the thresholds in words; threshold by group; best one of the groups that choose.
    """
    choosing = {group: counts for group, counts in groups.items() if group not in left_out}
    best = shared_threshold(choosing)
    if contender.earlier_threshold is not None:
        return "an earlier run", dict.fromkeys(groups, contender.earlier_threshold), best
    if len(choosing) > 1:
        held_out = held_out_thresholds(choosing)
        return "the other groups", {group: held_out.get(group, best) for group in groups}, best
    return "the detector's default", dict.fromkeys(groups, contender.threshold), best


# --- from counts to scores -------------------------------------------------------------


def summarise(
    contender: Contender,
    tally: Tally,
    measures: Sequence[Measure] = MEASURES,
    left_out: Collection[str] = (),
    conditions: Mapping[str, Sequence[LabelledItem]] | None = None,
) -> DetectorScores:
    """Compute all scores of one detector but its intervals.

    left_out: groups that count in no score but their own. conditions: images by condition, which
    are pooled across groups.
    """
    source, thresholds, best = choose_thresholds(contender, tally.road, left_out)
    counting = {group: value for group, value in thresholds.items() if group not in left_out}
    group_counts = {
        group: replace(pool_groups(tally, {group: threshold}), threshold=threshold)
        for group, threshold in thresholds.items()
    }
    by_condition = {
        name: pool(images, {group: thresholds[group] for group in images.groups})
        for name, items in (conditions or {}).items()
        if (images := tally.table(names={item.name for item in items})).names
    }
    is_whole = list(group_counts) == [UNGROUPED]
    whole = group_counts[UNGROUPED] if is_whole else pool_groups(tally, counting)
    scores = {group: compute_scores(part, measures) for group, part in group_counts.items()}
    groups = {} if is_whole else {group: scores[group] for group in counting}
    pooled = {} if is_whole else compute_scores(whole, measures)
    return DetectorScores(
        contender,
        scores[UNGROUPED] if is_whole else aggregate_groups(groups, pooled, measures),
        groups=groups,
        pooled=pooled,
        left_out={group: values for group, values in scores.items() if group not in counting},
        conditions={name: compute_scores(part, measures) for name, part in by_condition.items()},
        thresholds=thresholds,
        threshold_from=source,
        best_threshold=best,
    )


def pool_groups(tally: Tally, thresholds: Mapping[str, float]) -> PooledCounts:
    """Add up the counts of the groups that have thresholds."""
    road = {group: tally.road[group] for group in thresholds}
    return pool(tally.table(thresholds), thresholds, road=road)


def compute_scores(part: PooledCounts, measures: Sequence[Measure]) -> Scores:
    """Compute the measures that apply to some counts."""
    values = {measure.key: measure.formula(part) for measure in measures}
    return {
        key: value.item() if isinstance(value, Tensor) else value
        for key, value in values.items()
        if value is not None
    }


def aggregate_groups(
    groups: Mapping[str, Scores], pooled: Scores, measures: Sequence[Measure]
) -> Scores:
    """Return the headline scores: means over the groups, or those of the whole set."""
    scores = {}
    for measure in measures:
        if measure.key in pooled and measure.aggregate == "whole":
            scores[measure.key] = pooled[measure.key]
        elif measure.key in pooled and measure.aggregate == "mean":
            defined = measure.get_defined(groups).values()
            scores[measure.key] = sum(defined) / len(defined) if defined else math.nan
    return scores


# --- single images ---------------------------------------------------------------------


def image_f(images: ImageTable, thresholds: Mapping[str, float]) -> Tensor:
    """Compute F of images at their groups' thresholds, from 8-bit maps: float64 (n,), or NaN."""
    f = torch.full((len(images.names),), math.nan, dtype=torch.float64)
    for group, threshold in thresholds.items():
        if not math.isnan(threshold):
            members = images.group_mask(group)
            counts = RoadCounts(images.road.road[members], images.road.background[members])
            outcome = metrics.confusion_at(counts, threshold)
            has_road = outcome.true_positive + outcome.false_negative > 0
            f[members] = metrics.f_measure(outcome).where(has_road, torch.nan)
    return f


def rank_images(tally: Tally, scores: DetectorScores) -> list[tuple[float, str]]:
    """Return (F, name) of the images with road that count, best first."""
    images = tally.table(scores.counted_groups)
    values = image_f(images, scores.thresholds).tolist()
    with_road = [pair for pair in zip(values, images.names, strict=True) if not math.isnan(pair[0])]
    return sorted(with_road, key=lambda pair: (-pair[0], pair[1]))


def select_examples(
    order: Sequence[tuple[float, str]], count: int
) -> dict[str, Sequence[tuple[float, str]]]:
    """Return the first ``count`` images, those in the middle, and the last, worst first."""
    begin = max((len(order) - count) // 2, 0)
    return {
        "best": order[:count],
        "median": order[begin : begin + count],
        "worst": order[::-1][:count],
    }
