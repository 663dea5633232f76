"""What an evaluation found: figures by detector and group, from counts at chosen thresholds."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.evaluation import metrics
from roadtorch.evaluation.measure import Figures, Measure, Place
from roadtorch.evaluation.measures import MAXF, MEASURES
from roadtorch.evaluation.methods import Contender
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.evaluation.tally import WHOLE, Images, Part, Tally


class Interval(NamedTuple):
    """Both ends of a 95 % interval; NaN where no draw has a value."""

    low: float = math.nan
    high: float = math.nan

    @property
    def is_known(self) -> bool:
        """Whether it has two ends."""
        return not math.isnan(self.low) and not math.isnan(self.high)


@dataclass(frozen=True)
class DetectorFigures:
    """The figures of one detector.

    headline: means over the groups, or the figures of a set that knows none. pooled: of all
    groups' counts together; without groups it and ``groups`` are empty. left_out: the groups
    that count in nothing above. conditions: of the images of each condition together,
    on 8-bit maps.
    thresholds: the chosen one of each group (of ``WHOLE`` without groups); threshold_from:
    where they come from, in words. best_threshold: that of the highest F, averaged over the
    groups. intervals: by the key of the measure.
    """

    contender: Contender
    headline: Figures
    groups: Mapping[str, Figures] = field(default_factory=dict)
    pooled: Figures = field(default_factory=dict)
    left_out: Mapping[str, Figures] = field(default_factory=dict)
    conditions: Mapping[str, Figures] = field(default_factory=dict)
    thresholds: Mapping[str, float] = field(default_factory=dict)
    threshold_from: str = ""
    best_threshold: float = math.nan
    intervals: Mapping[str, Interval] = field(default_factory=dict)

    @property
    def interval(self) -> Interval:
        """That of MaxF."""
        return self.intervals.get(MAXF.key, Interval())

    @property
    def rank(self) -> float:
        """MaxF, to compare detectors by; below any other where it is undefined."""
        return -math.inf if math.isnan(maxf := MAXF.of(self.headline)) else maxf

    @property
    def counting(self) -> list[str]:
        """The groups of the tally that count: all groups but those left out."""
        return list(self.groups) or [WHOLE]

    @property
    def is_baseline(self) -> bool:
        """Whether the detector never looks at the image."""
        return self.contender.is_baseline

    def group(self, name: str) -> Figures:
        """The figures of one group, left out or not; none where it is not known."""
        return self.groups.get(name, self.left_out.get(name, {}))


@dataclass(frozen=True)
class Difference:
    """How much larger a figure is than that of another detector, with its 95 % interval."""

    value: float
    interval: Interval


@dataclass(frozen=True)
class Comparison:
    """All detectors less the one called ``against``: differences by detector and measure's key."""

    against: str
    differences: Mapping[str, Mapping[str, Difference]]


@dataclass(frozen=True)
class Failure:
    """An image that could not be scored, and so counts for no detector."""

    image: str
    group: str | None
    reason: str


@dataclass(frozen=True)
class Evaluation:
    """A run: the set, what was asked, and what was found.

    tallies: by detector, the counts that the figures are made of. measures: those that the
    figures have, in the order in which they are shown.
    """

    dataset: Dataset
    detectors: Mapping[str, DetectorFigures]
    comparison: Comparison
    failures: Sequence[Failure] = ()
    tallies: Mapping[str, Tally] = field(default_factory=dict, repr=False)
    measures: Sequence[Measure] = field(default=MEASURES, repr=False)

    @property
    def headlines(self) -> dict[str, Figures]:
        """The headline figures by detector."""
        return {name: figures.headline for name, figures in self.detectors.items()}

    def of_group(self, group: str) -> dict[str, Figures]:
        """The figures of one group by detector."""
        return {name: figures.group(group) for name, figures in self.detectors.items()}

    @property
    def images(self) -> int:
        """How many images were scored."""
        return len(self.dataset.items) - len(self.failures)

    @property
    def groups(self) -> list[str]:
        """The groups that count and that any detector has figures of, sorted."""
        return sorted({group for figures in self.detectors.values() for group in figures.groups})

    @property
    def conditions(self) -> list[str]:
        """The conditions that any detector has figures of, sorted."""
        return sorted({name for figures in self.detectors.values() for name in figures.conditions})

    @property
    def left_out(self) -> list[str]:
        """The groups that have figures but count in no mean, sorted."""
        return sorted({group for figures in self.detectors.values() for group in figures.left_out})

    def ranked(self) -> list[str]:
        """The detectors by MaxF, highest first; those without one last, then by name."""
        return sorted(self.detectors, key=lambda name: (-self.detectors[name].rank, name))

    def shown_in(self, *tables: Place) -> list[Measure]:
        """The measures that are columns of one of these tables."""
        return [measure for measure in self.measures if set(tables) & set(measure.shown)]


# --- thresholds that labels choose ------------------------------------------------------


def shared_threshold(groups: Mapping[str, RoadCounts]) -> float:
    """The threshold with the highest F, averaged over groups; the lowest of equals.

    NaN when no group has road.
    """
    known = [metrics.f_curve(counts) for counts in groups.values() if counts.road.sum() > 0]
    return float(metrics.best_threshold(torch.stack(known).mean(0))[1]) if known else math.nan


def held_out_thresholds(groups: Mapping[str, RoadCounts]) -> dict[str, float]:
    """For every group the threshold that the other groups choose; it never sees its own."""
    return {
        group: shared_threshold({name: groups[name] for name in groups if name != group})
        for group in groups
    }


def choose_thresholds(
    contender: Contender, groups: Mapping[str, RoadCounts], left_out: Collection[str] = ()
) -> tuple[str, Mapping[str, float], float]:
    """Where thresholds come from, in words; one for every group; the best of those that choose.

    They are of an earlier run, or of the other groups, or the detector's default. left_out: groups
    that choose for nobody.
    """
    choosing = {group: counts for group, counts in groups.items() if group not in left_out}
    best = shared_threshold(choosing)
    if contender.chosen is not None:
        return "an earlier run", dict.fromkeys(groups, contender.chosen), best
    if len(choosing) > 1:
        held_out = held_out_thresholds(choosing)
        return "the other groups", {group: held_out.get(group, best) for group in groups}, best
    return "the detector's default", dict.fromkeys(groups, contender.threshold), best


# --- from counts to figures -------------------------------------------------------------


def summarise(
    contender: Contender,
    tally: Tally,
    measures: Sequence[Measure] = MEASURES,
    left_out: Collection[str] = (),
    conditions: Mapping[str, Sequence[LabelledItem]] | None = None,
) -> DetectorFigures:
    """All figures of one detector but its intervals.

    left_out: groups that count in nothing but their own. conditions: images by condition,
    which have figures together, whatever groups they are of.
    """
    source, thresholds, best = choose_thresholds(contender, tally.road, left_out)
    counting = {
        group: threshold for group, threshold in thresholds.items() if group not in left_out
    }
    parts = {
        group: replace(of_groups(tally, {group: threshold}), threshold=threshold)
        for group, threshold in thresholds.items()
    }
    of_condition = {
        name: of_images(images, thresholds)
        for name, items in (conditions or {}).items()
        if (images := tally.named({item.name for item in items})).names
    }
    is_whole = list(parts) == [WHOLE]
    whole = parts[WHOLE] if is_whole else of_groups(tally, counting)
    figures = {group: figures_of(part, measures) for group, part in parts.items()}
    groups = {} if is_whole else {group: figures[group] for group in counting}
    pooled = {} if is_whole else figures_of(whole, measures)
    return DetectorFigures(
        contender,
        figures[WHOLE] if is_whole else over_groups(groups, pooled, measures),
        groups=groups,
        pooled=pooled,
        left_out={group: own for group, own in figures.items() if group not in counting},
        conditions={name: figures_of(part, measures) for name, part in of_condition.items()},
        thresholds=thresholds,
        threshold_from=source,
        best_threshold=best,
    )


def of_groups(tally: Tally, thresholds: Mapping[str, float]) -> Part:
    """Add up the counts of the groups that have thresholds."""
    counts = {group: tally.road[group] for group in thresholds}
    return _add_up(tally.kept(thresholds), counts, thresholds)


def of_images(images: Images, thresholds: Mapping[str, float]) -> Part:
    """Add up the counts of images of any groups, on 8-bit maps; thresholds: of their groups."""
    counts = {
        group: RoadCounts(images.road.road[own].sum(0), images.road.other[own].sum(0))
        for group in dict.fromkeys(images.groups)
        for own in [images.of_group(group)]
    }
    return _add_up(images, counts, thresholds)


def _add_up(
    images: Images, counts: Mapping[str, RoadCounts], thresholds: Mapping[str, float]
) -> Part:
    """Add images up; counts: of their likelihoods, by group."""
    areas = [area for area in images.auc.tolist() if not math.isnan(area)]
    layout, labels = (
        rows.sum(0) if rows is not None and rows.any() else None
        for rows in (images.layout, images.labels)
    )
    outcomes = [
        metrics.decisions_at(counts[group], thresholds[group])
        for group in counts
        if not math.isnan(thresholds[group])
    ]
    return Part(
        reduce(add, counts.values()),
        Decisions(*images.outcomes.sum(0)),
        images.boundary.sum(0),
        layout,
        reduce(add, outcomes) if outcomes else None,
        torch.tensor(sum(areas) / len(areas) if areas else math.nan, dtype=torch.float64),
        labels,
        images=images,
    )


def figures_of(part: Part, measures: Sequence[Measure]) -> Figures:
    """The measures of a part, without those that it does not have."""
    values = {measure.key: measure.formula(part) for measure in measures}
    return {
        key: value.item() if isinstance(value, Tensor) else value
        for key, value in values.items()
        if value is not None
    }


def over_groups(
    groups: Mapping[str, Figures], pooled: Figures, measures: Sequence[Measure]
) -> Figures:
    """What stands above the figures of the groups: means, or those of all images together."""
    figures = {}
    for measure in measures:
        if measure.key in pooled and measure.over_groups == "whole":
            figures[measure.key] = pooled[measure.key]
        elif measure.key in pooled and measure.over_groups == "mean":
            figures[measure.key] = mean([measure.of(group) for group in groups.values()])
    return figures


def mean(values: Sequence[float]) -> float:
    """The mean of the defined values; NaN when there is none."""
    defined = [value for value in values if not math.isnan(value)]
    return sum(defined) / len(defined) if defined else math.nan


# --- single images ---------------------------------------------------------------------


def image_f(images: Images, thresholds: Mapping[str, float]) -> Tensor:
    """F of each image at its group's threshold, of its 8-bit map, float64 (n,).

    NaN without road or threshold.
    """
    f = torch.full((len(images.names),), math.nan, dtype=torch.float64)
    for group, threshold in thresholds.items():
        if not math.isnan(threshold):
            own = images.of_group(group)
            counts = RoadCounts(images.road.road[own], images.road.other[own])
            outcome = metrics.decisions_at(counts, threshold)
            has_road = outcome.true_positive + outcome.false_negative > 0
            f[own] = metrics.f_measure(outcome).where(has_road, torch.nan)
    return f


def images_by_f(tally: Tally, figures: DetectorFigures) -> list[tuple[float, str]]:
    """(F, name) of the images with road that count, the best first."""
    images = tally.kept(figures.counting)
    values = image_f(images, figures.thresholds).tolist()
    with_road = [pair for pair in zip(values, images.names, strict=True) if not math.isnan(pair[0])]
    return sorted(with_road, key=lambda pair: (-pair[0], pair[1]))


def best_median_worst(
    order: Sequence[tuple[float, str]], count: int
) -> dict[str, Sequence[tuple[float, str]]]:
    """The first ``count`` of images, those in the middle, and the last, from the last on."""
    begin = max((len(order) - count) // 2, 0)
    return {
        "best": order[:count],
        "median": order[begin : begin + count],
        "worst": order[::-1][:count],
    }
