"""What is counted in a pass, and kept: sums by group, a few numbers of each picture.

Sums have one size whatever the number of pictures. Of each picture its 8-bit histograms
stay (2 kB), for distributions, intervals and comparisons.
"""

import math
import statistics
from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add

import torch
from torch import Tensor

from roadtorch.data.dataset import Item
from roadtorch.evaluation import curves, metrics
from roadtorch.evaluation.curves import Curve
from roadtorch.evaluation.measure import Part, Trusted
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

    item: Item
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

    def add(self, item: Item, score: Score) -> None:
        """Count one more picture."""
        group, mask = item.group or WHOLE, score.mask
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
        outcome = (mask.true_positive, mask.false_positive, mask.false_negative, mask.true_negative)
        known = {
            "road": torch.stack([coarse.road, coarse.other]).to(torch.int32),
            "mask": torch.stack(outcome),
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
        parts = [of_kind[group] for group in groups if group in of_kind]
        return sum(parts[1:], start=parts[0]) if parts else None

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


def of_groups(tally: Tally, thresholds: Mapping[str, float]) -> Part:
    """The groups that have thresholds, their counts added up."""
    counts = {group: tally.road[group] for group in thresholds}
    roc, labels = vertical_roc(tally, thresholds), tally.total("labels", thresholds)
    return replace(_together(tally.kept(thresholds), counts, thresholds), roc=roc, labels=labels)


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
    roc = curves.vertical_average(rates.mean(0)) if known.any() else None
    return replace(_together(pictures, counts, thresholds), roc=roc)


def _together(
    pictures: Pictures, counts: Mapping[str, RoadCounts], thresholds: Mapping[str, float]
) -> Part:
    """Pictures added up; counts: of their likelihoods, by group."""
    areas = [area for area in pictures.auc.tolist() if not math.isnan(area)]
    mean_area = sum(areas) / len(areas) if areas else math.nan
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
        torch.tensor(mean_area, dtype=torch.float64),
        images=len(pictures.names),
        skipped=len(pictures.names) - len(areas),
        milliseconds=1000 * statistics.median(pictures.seconds.tolist()),
        trusted=trusted(pictures),
    )


def vertical_roc(tally: Tally, groups: Collection[str]) -> Curve | None:
    """The vertical average of the single pictures' ROC; None where none has any."""
    summed, known = tally.total("curve", groups), ~tally.kept(groups).auc.isnan()
    return None if summed is None else curves.vertical_average(summed / int(known.sum()))


def trusted(pictures: Pictures) -> Trusted | None:
    """The pictures that have a trust and an F of the mask; None where no picture has a trust."""
    if pictures.trust.isnan().all():
        return None
    f = metrics.f_measure(pictures.mask)
    known = ~(pictures.trust.isnan() | f.isnan())
    groups = [group for group, kept in zip(pictures.groups, known.tolist(), strict=True) if kept]
    return Trusted(pictures.trust[known], f[known], groups)


def drawn(pictures: Pictures, threshold: float, weights: Tensor) -> Part:
    """The pictures of one group, each as often as weights (draws,n) say, on 8-bit maps."""
    road = metrics.pool(pictures.road, weights)
    known = ~pictures.auc.isnan()
    areas, of_known = pictures.auc[known], weights[:, known].to(torch.float64)
    return Part(
        road,
        Decisions(*_weighted(pictures.outcomes, weights).unbind(1)),
        _weighted(pictures.boundary, weights),
        None if pictures.layout is None else _weighted(pictures.layout, weights),
        None if math.isnan(threshold) else metrics.decisions_at(road, threshold),
        (of_known @ areas) / of_known.sum(1),
    )


def _weighted(counts: Tensor, weights: Tensor) -> Tensor:
    """Sums of counts (n,…) over the pictures, as often as each is drawn: float64 (draws,…)."""
    flat = weights.to(torch.float64) @ counts.flatten(1).to(torch.float64)
    return flat.reshape(-1, *counts.shape[1:])
