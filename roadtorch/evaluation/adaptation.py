"""What further training changed: the same pictures before and after it. Ours."""

import math
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from roadtorch.data.dataset import Dataset
from roadtorch.evaluation.contenders import Contender
from roadtorch.evaluation.disagreement import Disagreement, disagreement, seen_by_both, worst_first
from roadtorch.evaluation.result import Failure


@dataclass(frozen=True)
class Change:
    """One picture before (first) and after (second); trust: NaN where the detector has none."""

    masks: Disagreement
    trust_before: float
    trust_after: float


@dataclass(frozen=True)
class MeanChange:
    """Means over the pictures. differs, median, most: share of the pixels; grown, shrunk:
    pictures on which trust rose or fell; trust: NaN without any."""

    pictures: int
    differs: float
    median: float
    most: float
    road_before: float
    road_after: float
    trust_before: float
    trust_after: float
    grown: int
    shrunk: int


class Agreement(NamedTuple):
    """Shares of the pixels, where the teacher is sure, on which a network says the same.

    layout: the class; road: road or not. pictures: how many were asked.
    """

    layout: float
    road: float
    pictures: int


class Taught(NamedTuple):
    """The teacher's name, and how far the network agreed with it before, and does now."""

    teacher: str
    before: Agreement
    after: Agreement


def changes(dataset: Dataset, before: Contender, after: Contender) -> Iterator[Change | Failure]:
    """Each picture of a set as it was and is seen, or why not."""
    for seen in seen_by_both(dataset, before, after):
        if isinstance(seen, Failure):
            yield seen
            continue
        masks = disagreement(seen.item, seen.first.mask, seen.second.mask)
        trusts = [math.nan if one.trust is None else one.trust for one in (seen.first, seen.second)]
        yield Change(masks, *trusts)


def mean_change(found: Sequence[Change]) -> MeanChange:
    """What all pictures (one at least) say together."""
    masks, trusted = [one.masks for one in found], [one for one in found if _has_trust(one)]
    differs = [one.differs for one in masks]
    return MeanChange(
        pictures=len(found),
        differs=statistics.fmean(differs),
        median=statistics.median(differs),
        most=max(differs),
        road_before=statistics.fmean(one.first for one in masks),
        road_after=statistics.fmean(one.second for one in masks),
        trust_before=_mean([one.trust_before for one in trusted]),
        trust_after=_mean([one.trust_after for one in trusted]),
        grown=sum(one.trust_after > one.trust_before for one in trusted),
        shrunk=sum(one.trust_after < one.trust_before for one in trusted),
    )


def _has_trust(one: Change) -> bool:
    return not math.isnan(one.trust_before + one.trust_after)


def _mean(values: Sequence[float]) -> float:
    return statistics.fmean(values) if values else math.nan


def most_and_spread(found: Sequence[Change], count: int) -> list[Change]:
    """So many pictures to look at: half of them changed most, the others are evenly spread.

    The spread is over what is left, from much changed to little, the least changed included.
    All, the most changed first, where there are no more than ``count``.
    """
    order = {
        one.item.name: place for place, one in enumerate(worst_first([c.masks for c in found]))
    }
    ranked = sorted(found, key=lambda one: order[one.masks.item.name])
    if len(ranked) <= count:
        return ranked
    most, rest = ranked[: count - count // 2], ranked[count - count // 2 :]
    steps = count // 2
    return most + [rest[(place + 1) * len(rest) // steps - 1] for place in range(steps)]
