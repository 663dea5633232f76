"""What an evaluation found: figures by detector and group, their intervals, differences."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from roadtorch.data.dataset import Dataset
from roadtorch.evaluation.measure import Figures, Measure, Place
from roadtorch.evaluation.measures import MAXF, MEASURES
from roadtorch.evaluation.methods import Method
from roadtorch.evaluation.tally import WHOLE, Tally


class Interval(NamedTuple):
    """Both ends of a 95 % interval; NaN where no draw has a value."""

    low: float = math.nan
    high: float = math.nan

    @property
    def is_known(self) -> bool:
        """Whether it has two ends."""
        return not math.isnan(self.low) and not math.isnan(self.high)


@dataclass(frozen=True)
class PicturesByF:
    """F of the single pictures at their group's threshold.

    quantiles: by share of the pictures, empty without any. best, median, worst: some
    pictures as (F, name).
    """

    quantiles: Mapping[float, float] = field(default_factory=dict)
    best: Sequence[tuple[float, str]] = ()
    median: Sequence[tuple[float, str]] = ()
    worst: Sequence[tuple[float, str]] = ()


@dataclass(frozen=True)
class DetectorFigures:
    """The figures of one detector.

    headline: means over the groups, or the figures of a set that knows none. pooled: of all
    groups' counts together; without groups it and ``groups`` are empty. left_out: the groups
    that count in nothing above. conditions: of the pictures of each condition together,
    on 8-bit maps.
    thresholds: the chosen one of each group (of ``WHOLE`` without groups); threshold_from:
    where they come from, in words. best_threshold: that of the highest F, averaged over the
    groups. intervals: by the key of the measure.
    """

    method: Method
    headline: Figures
    groups: Mapping[str, Figures] = field(default_factory=dict)
    pooled: Figures = field(default_factory=dict)
    left_out: Mapping[str, Figures] = field(default_factory=dict)
    conditions: Mapping[str, Figures] = field(default_factory=dict)
    thresholds: Mapping[str, float] = field(default_factory=dict)
    threshold_from: str = ""
    best_threshold: float = math.nan
    intervals: Mapping[str, Interval] = field(default_factory=dict)
    pictures_by_f: PicturesByF = field(default_factory=PicturesByF)

    @property
    def interval(self) -> Interval:
        """That of MaxF."""
        return self.intervals.get(MAXF.key, Interval())

    @property
    def counting(self) -> list[str]:
        """The groups of the tally that count: all groups but those left out."""
        return list(self.groups) or [WHOLE]

    @property
    def is_baseline(self) -> bool:
        """Whether the detector never looks at the picture."""
        return self.method.is_baseline

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
    """A picture that could not be scored, and so counts for no detector."""

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
    def images(self) -> int:
        """How many pictures were scored."""
        return len(self.dataset.items) - len(self.failures)

    @property
    def groups(self) -> list[str]:
        """The groups that count and that any detector has figures of, sorted."""
        return sorted({group for one in self.detectors.values() for group in one.groups})

    @property
    def conditions(self) -> list[str]:
        """The conditions that any detector has figures of, sorted."""
        return sorted({name for one in self.detectors.values() for name in one.conditions})

    @property
    def left_out(self) -> list[str]:
        """The groups that have figures but count in no mean, sorted."""
        return sorted({group for one in self.detectors.values() for group in one.left_out})

    def ranked(self) -> list[str]:
        """The detectors by MaxF, highest first; those without one last, then by name."""

        def place(name: str) -> tuple[float, str]:
            value = MAXF.of(self.detectors[name].headline)
            return (math.inf if math.isnan(value) else -value), name

        return sorted(self.detectors, key=place)

    def shown_in(self, *tables: Place) -> list[Measure]:
        """The measures that are columns of one of these tables."""
        return [one for one in self.measures if set(tables) & set(one.shown)]
