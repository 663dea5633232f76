"""What is counted in a pass, and kept: sums by group, a few numbers of each picture.

Sums have one size whatever the number of pictures. Of each picture its 8-bit histograms
stay (2 kB), for distributions, intervals and comparisons.
"""

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from operator import add

import torch
from torch import Tensor

from roadtorch.data.dataset import LabelledItem
from roadtorch.evaluation import curves, metrics
from roadtorch.evaluation.metrics import Decisions, RoadCounts

WHOLE = "all"  # the one group of a set that knows no groups
COARSE = 256  # levels that are kept of each picture
FIRST_ROWS = 64  # pictures that there is room for before a column grows


@dataclass(frozen=True)
class Score:
    """One detector's counts on one picture, in the space of the truth."""

    road: RoadCounts
    mask: Decisions
    boundary: Tensor  # int64 (tolerances,4), see boundary.py
    layout: Tensor | None  # confusion (4,4) of the strongest potentials
    labels: Tensor | None  # confusion (4,4) of labels that may abstain
    seconds: float = math.nan  # for detect alone, as if nothing had been shared
    trust: float = math.nan  # the expected F of the mask; NaN where the detector does not say


@dataclass(frozen=True)
class Scored:
    """What came of one picture: a score for every detector, or why there is none."""

    item: LabelledItem
    scores: Mapping[str, Score]
    failure: str = ""


@dataclass(frozen=True)
class Pictures:
    """What is kept of n pictures: a row of every tensor is one of them."""

    names: Sequence[str]
    groups: Sequence[str]
    road: RoadCounts  # int32 (n,COARSE)
    outcomes: Tensor  # int64 (n,4), the fields of Decisions
    boundary: Tensor  # int64 (n,tolerances,4)
    layout: Tensor | None  # int64 (n,4,4)
    auc: Tensor  # float64 (n,), NaN without road or background
    max_f: Tensor  # float64 (n,), NaN without road
    seconds: Tensor  # float64 (n,)
    trust: Tensor  # float64 (n,), NaN where the detector does not say

    @property
    def mask(self) -> Decisions:
        """The outcomes of the masks, int64 (n,) each."""
        return Decisions(*self.outcomes.unbind(1))

    def of_group(self, group: str) -> Tensor:
        """Which of the pictures are of a group, bool (n,)."""
        return torch.tensor([name == group for name in self.groups], dtype=torch.bool)


@dataclass
class Tally:
    """One detector's counts so far: sums by kind and group, and columns with a row a picture.

    Kinds of sums: ``road`` (2,levels), ``labels`` as a score has them, and ``curve``, the single
    pictures' ROC. Rows are written into a few large tensors that double when they are full:
    thousands of small ones between the large temporary ones of counting would keep their memory
    in use.
    """

    sums: dict[str, dict[str, Tensor]] = field(default_factory=dict)
    pictures: list[tuple[str, str]] = field(default_factory=list)  # name and group of each row
    columns: dict[str, Tensor] = field(default_factory=dict, repr=False)

    def add(self, item: LabelledItem, score: Score) -> None:
        """Count one more picture."""
        group = item.group or WHOLE
        area, best = float(metrics.auc(score.road)), float(metrics.max_f(score.road)[0])
        summed = {
            "road": torch.stack([score.road.road, score.road.other]),
            "labels": score.labels,
            "curve": None if math.isnan(area) else curves.vertical_sample(score.road),
        }
        for kind, part in summed.items():
            if part is not None:
                sums = self.sums.setdefault(kind, {})
                sums[group] = sums[group] + part if group in sums else part
        coarse = metrics.coarsen(score.road, COARSE)
        known = {
            "road": torch.stack([coarse.road, coarse.other]).to(torch.int32),
            "mask": torch.stack(score.mask),
            "boundary": score.boundary,
            "numbers": torch.tensor([area, best, score.seconds, score.trust], dtype=torch.float64),
        }
        if score.layout is not None:
            known["layout"] = score.layout
        row = len(self.pictures)
        for key in known.keys() - self.columns.keys():
            self.columns[key] = known[key].new_zeros((FIRST_ROWS, *known[key].shape))
        for key, column in self.columns.items():  # those as well that this picture has not
            while len(column) <= row:
                column = torch.cat([column, torch.zeros_like(column)])
            if key in known:
                column[row] = known[key]
            self.columns[key] = column
        self.pictures.append((item.name, group))

    @property
    def road(self) -> dict[str, RoadCounts]:
        """Pixels by likelihood level, by group."""
        return {group: RoadCounts(*counts) for group, counts in self.sums.get("road", {}).items()}

    def total(self, kind: str, groups: Iterable[str]) -> Tensor | None:
        """The sum of one kind over some groups; None where none of them has any."""
        of_kind = self.sums.get(kind, {})
        sums = [of_kind[group] for group in groups if group in of_kind]
        return sum(sums[1:], start=sums[0]) if sums else None

    def kept(self, groups: Iterable[str] | None = None) -> Pictures:
        """What is kept of some groups' pictures, group by group, or of all in their order."""
        places = range(len(self.pictures))
        if groups is not None:
            places = [i for group in groups for i in places if self.pictures[i][1] == group]
        return self._rows(places)

    def named(self, names: Container[str]) -> Pictures:
        """What is kept of the pictures of these names, in their order."""
        return self._rows([i for i, (name, _) in enumerate(self.pictures) if name in names])

    def _rows(self, places: Sequence[int]) -> Pictures:
        chosen = torch.tensor(list(places), dtype=torch.int64)
        columns = {key: column[chosen] for key, column in self.columns.items()}
        return Pictures(
            [self.pictures[i][0] for i in places],
            [self.pictures[i][1] for i in places],
            RoadCounts(*columns["road"].unbind(1)),
            columns["mask"],
            columns["boundary"],
            columns.get("layout"),
            *columns["numbers"].unbind(1),
        )

    def sort(self, names: Sequence[str]) -> None:
        """Bring the pictures into the order of ``names``."""
        place = {name: index for index, name in enumerate(names)}
        order = sorted(range(len(self.pictures)), key=lambda i: place[self.pictures[i][0]])
        self.pictures = [self.pictures[index] for index in order]
        self.columns = {key: column[order] for key, column in self.columns.items()}


# --- what measures are taken of ---------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """Counts of some pictures together, or of many draws of them: then all have (draws,…).

    chosen: the outcome at the threshold of each group; None where there is none.
    image_auc: the mean of the single pictures' AUC, float64 (…).
    What follows in the list is not known of draws: labels, a confusion as ``layout``, of
    labels that may abstain; rates, the single pictures' mean TPR at equal FPRs; threshold,
    where there is one for all; the single pictures.
    """

    road: RoadCounts
    mask: Decisions
    boundary: Tensor
    layout: Tensor | None
    chosen: Decisions | None
    image_auc: Tensor
    labels: Tensor | None = None
    rates: Tensor | None = None
    threshold: float | None = None
    pictures: Pictures | None = None

    @cached_property
    def max_f(self) -> tuple[Tensor, Tensor]:
        """KITTI's MaxF and its threshold, see ``metrics.max_f``."""
        return metrics.max_f(self.road)

    @cached_property
    def working_point(self) -> Mapping[str, Tensor]:
        """KITTI's figures where F is highest, see ``metrics.working_point``."""
        return metrics.working_point(self.road)


def of_groups(tally: Tally, thresholds: Mapping[str, float]) -> Part:
    """The groups that have thresholds, their counts added up."""
    counts = {group: tally.road[group] for group in thresholds}
    part = _together(tally.kept(thresholds), counts, thresholds)
    return replace(
        part, labels=tally.total("labels", thresholds), rates=mean_rates(tally, thresholds)
    )


def of_pictures(pictures: Pictures, thresholds: Mapping[str, float]) -> Part:
    """Pictures of any groups, their counts added up, on 8-bit maps.

    thresholds: those of their groups. Labels that may abstain are not known.
    """
    counts = {
        group: RoadCounts(pictures.road.road[own].sum(0), pictures.road.other[own].sum(0))
        for group in dict.fromkeys(pictures.groups)
        for own in [pictures.of_group(group)]
    }
    known = ~pictures.auc.isnan()
    rates = curves.vertical_sample(
        RoadCounts(pictures.road.road[known], pictures.road.other[known])
    )
    part = _together(pictures, counts, thresholds)
    return replace(part, rates=rates.mean(0) if known.any() else None)


def _together(
    pictures: Pictures, counts: Mapping[str, RoadCounts], thresholds: Mapping[str, float]
) -> Part:
    """Pictures added up; counts: of their likelihoods, by group."""
    areas = [area for area in pictures.auc.tolist() if not math.isnan(area)]
    layout = pictures.layout
    outcomes = [
        metrics.decisions_at(counts[group], thresholds[group])
        for group in counts
        if not math.isnan(thresholds[group])
    ]
    return Part(
        reduce(add, counts.values()),
        Decisions(*pictures.outcomes.sum(0)),
        pictures.boundary.sum(0),
        layout.sum(0) if layout is not None and layout.any() else None,
        reduce(add, outcomes) if outcomes else None,
        torch.tensor(sum(areas) / len(areas) if areas else math.nan, dtype=torch.float64),
        pictures=pictures,
    )


def mean_rates(tally: Tally, groups: Iterable[str]) -> Tensor | None:
    """The single pictures' mean TPR at equal FPRs; None where none has any."""
    groups = list(groups)
    summed, known = tally.total("curve", groups), ~tally.kept(groups).auc.isnan()
    return None if summed is None else summed / int(known.sum())
