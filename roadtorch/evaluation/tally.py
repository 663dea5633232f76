"""What is kept of a pass: sums by drive, a few numbers of each picture; to tensors and back.

Sums have one size whatever the number of pictures. Of each picture its 8-bit histograms
stay (2 kB), for distributions, intervals and comparisons.
"""

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import torch
from torch import Tensor

from roadtorch.data.dataset import Item
from roadtorch.evaluation import curves, metrics
from roadtorch.evaluation.metrics import Decisions, RoadCounts

WHOLE = "all"  # the one group of a set that knows no drives
COARSE = 256  # levels that are kept of each picture
FIRST_ROWS = 64  # pictures that there is room for before a column grows

Counts = TypeVar("Counts", RoadCounts, Decisions, Tensor)


@dataclass(frozen=True)
class Score:
    """One detector's counts on one picture."""

    road: RoadCounts
    mask: Decisions
    boundary: Tensor  # int64 (tolerances,4), see boundary.py
    layout: Tensor | None  # confusion (4,4) of the strongest potentials
    labels: Tensor | None  # confusion (4,4) of labels that may abstain
    seconds: float  # for detect alone, as if nothing had been shared
    trust: float = math.nan  # the expected F of the mask; NaN where the detector does not say


@dataclass(frozen=True)
class Pictures:
    """What is kept of n pictures: a row of every tensor is one of them."""

    names: Sequence[str]
    groups: Sequence[str]
    road: RoadCounts  # int32 (n,COARSE)
    mask: Decisions  # int64 (n,)
    boundary: Tensor  # int64 (n,tolerances,4)
    layout: Tensor | None  # int64 (n,4,4)
    auc: Tensor  # float64 (n,), NaN without road or background
    max_f: Tensor  # float64 (n,), NaN without road
    seconds: Tensor  # float64 (n,)
    trust: Tensor  # float64 (n,), NaN where the detector does not say


@dataclass
class Tally:
    """One detector's counts so far: sums by drive, and columns with a row for each picture.

    Rows are written into a few large tensors that double when they are full: thousands of
    small ones between the large temporary ones of counting would keep their memory in use.
    """

    road: dict[str, RoadCounts] = field(default_factory=dict)
    mask: dict[str, Decisions] = field(default_factory=dict)
    boundary: dict[str, Tensor] = field(default_factory=dict)
    layout: dict[str, Tensor] = field(default_factory=dict)
    labels: dict[str, Tensor] = field(default_factory=dict)
    curve: dict[str, Tensor] = field(default_factory=dict)  # sums of single pictures' ROC
    pictures: list[tuple[str, str]] = field(default_factory=list)  # name and group of each row
    columns: dict[str, Tensor] = field(default_factory=dict, repr=False)

    def add(self, item: Item, score: Score) -> None:
        """Count one more picture."""
        group = item.group or WHOLE
        _add(self.road, group, score.road)
        _add(self.mask, group, score.mask)
        _add(self.boundary, group, score.boundary)
        if score.layout is not None:
            _add(self.layout, group, score.layout)
        if score.labels is not None:
            _add(self.labels, group, score.labels)
        area, best = float(metrics.auc(score.road)), float(metrics.max_f(score.road)[0])
        if not math.isnan(area):
            _add(self.curve, group, curves.vertical_sample(score.road))
        self._append(score, area, best)
        self.pictures.append((item.name, group))

    def _append(self, score: Score, area: float, best: float) -> None:
        values = {
            "road": _stacked("road", metrics.coarsen(score.road, COARSE)).to(torch.int32),
            "mask": _stacked("mask", score.mask),
            "boundary": score.boundary,
            "numbers": torch.tensor([area, best, score.seconds, score.trust], dtype=torch.float64),
        }
        if score.layout is not None:
            values["layout"] = score.layout
        row = len(self.pictures)
        for key in values.keys() - self.columns.keys():
            self.columns[key] = values[key].new_zeros((FIRST_ROWS, *values[key].shape))
        for key, column in self.columns.items():  # those as well that this picture has not
            while len(column) <= row:
                column = torch.cat([column, torch.zeros_like(column)])
            if key in values:
                column[row] = values[key]
            self.columns[key] = column

    def kept(self, groups: Iterable[str] | None = None) -> Pictures:
        """What is kept of some drives' pictures, drive by drive, or of all in their order."""
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
        auc, max_f, seconds, trust = columns["numbers"].unbind(1)
        return Pictures(
            [self.pictures[i][0] for i in places],
            [self.pictures[i][1] for i in places],
            RoadCounts(*columns["road"].unbind(1)),
            Decisions(*columns["mask"].unbind(1)),
            columns["boundary"],
            columns.get("layout"),
            auc,
            max_f,
            seconds,
            trust,
        )

    def sort(self, names: Sequence[str]) -> None:
        """Bring the pictures into the order of ``names``."""
        place = {name: index for index, name in enumerate(names)}
        order = sorted(range(len(self.pictures)), key=lambda i: place[self.pictures[i][0]])
        self.pictures = [self.pictures[index] for index in order]
        self.columns = {key: column[order] for key, column in self.columns.items()}


def _add(sums: dict[str, Counts], group: str, part: Counts) -> None:
    sums[group] = sums[group] + part if group in sums else part


# --- to tensors and back, for a run that is interrupted ---------------------------------

SUMS = ("road", "mask", "boundary", "layout", "labels", "curve")
PARTS = {
    "road": (RoadCounts, ("road", "other")),
    "mask": (
        Decisions,
        ("true_positive", "false_positive", "false_negative", "true_negative"),
    ),
}
"""Sums of several tensors: how to make them, and what from."""


def tally_tensors(tally: Tally) -> dict[str, Tensor]:
    """All numbers of a tally as tensors by name."""
    found: dict[str, Tensor] = {}
    for kind in SUMS:
        for group, counts in getattr(tally, kind).items():
            found[f"{kind}/{group}"] = _stacked(kind, counts)
    for key, column in tally.columns.items():
        found[f"rows/{key}"] = column[: len(tally.pictures)]
    return found


def tally_from(tensors: Mapping[str, Tensor], pictures: Sequence[Sequence[str]]) -> Tally:
    """The tally that ``tally_tensors`` took apart; pictures: name and group of its rows."""
    tally = Tally(pictures=[(name, group) for name, group in pictures])
    for key, tensor in tensors.items():
        kind, _, name = key.partition("/")
        if kind == "rows":
            tally.columns[name] = tensor
        else:
            getattr(tally, kind)[name] = _unstacked(kind, tensor)
    return tally


def _stacked(kind: str, counts: Any) -> Tensor:
    if kind not in PARTS:
        return counts
    return torch.stack([getattr(counts, part) for part in PARTS[kind][1]])


def _unstacked(kind: str, tensor: Tensor) -> Any:
    return PARTS[kind][0](*tensor.unbind(0)) if kind in PARTS else tensor
