"""What is counted in a pass, and kept: sums by group, a few numbers of each image.

Sums have one size whatever the number of images. Of each image its 8-bit histograms
stay (2 kB), for distributions, intervals and comparisons.
"""

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor

from roadtorch.data.dataset import LabelledItem
from roadtorch.evaluation import metrics
from roadtorch.evaluation.metrics import Decisions, RoadCounts

WHOLE = "all"  # the one group of a set that knows no groups
COARSE = 256  # levels that are kept of each image
FIRST_ROWS = 64  # images that there is room for before a column grows


@dataclass(frozen=True)
class Score:
    """One detector's counts on one image, in the space of the truth."""

    road: RoadCounts
    mask: Decisions
    boundary: Tensor  # int64 (tolerances,4), see boundary.py
    layout: Tensor | None  # confusion (4,4) of the strongest potentials
    labels: Tensor | None  # confusion (4,4) of labels that may abstain
    seconds: float = math.nan  # for detect alone, as if nothing had been shared
    trust: float = math.nan  # the expected F of the mask; NaN where the detector does not say


@dataclass(frozen=True)
class Scored:
    """What came of one image: a score for every detector, or why there is none."""

    item: LabelledItem
    scores: Mapping[str, Score]
    failure: str = ""


@dataclass(frozen=True)
class Images:
    """What is kept of n images: a row of every tensor is one of them."""

    names: Sequence[str]
    groups: Sequence[str]
    road: RoadCounts  # int32 (n,COARSE)
    outcomes: Tensor  # int64 (n,4), the fields of Decisions
    boundary: Tensor  # int64 (n,tolerances,4)
    layout: Tensor | None  # int64 (n,4,4)
    labels: Tensor | None  # int64 (n,4,4)
    auc: Tensor  # float64 (n,), NaN without road or background
    max_f: Tensor  # float64 (n,), NaN without road
    seconds: Tensor  # float64 (n,)
    trust: Tensor  # float64 (n,), NaN where the detector does not say

    @property
    def mask(self) -> Decisions:
        """The outcomes of the masks, int64 (n,) each."""
        return Decisions(*self.outcomes.unbind(1))

    def of_group(self, group: str) -> Tensor:
        """Which of the images are of a group, bool (n,)."""
        return torch.tensor([name == group for name in self.groups], dtype=torch.bool)


@dataclass
class Tally:
    """One detector's counts so far: pixels by likelihood and group, and columns by image.

    Rows are written into a few large tensors that double when they are full: thousands of small
    ones between the large temporary ones of counting would keep their memory in use.
    """

    road: dict[str, RoadCounts] = field(default_factory=dict)
    images: list[tuple[str, str]] = field(default_factory=list)  # name and group of each row
    columns: dict[str, Tensor] = field(default_factory=dict, repr=False)

    def add(self, item: LabelledItem, score: Score) -> None:
        """Count one more image."""
        group = item.group or WHOLE
        area, best = float(metrics.auc(score.road)), float(metrics.max_f(score.road)[0])
        self.road[group] = self.road[group] + score.road if group in self.road else score.road
        coarse = metrics.coarsen(score.road, COARSE)
        values = {
            "road": torch.stack([coarse.road, coarse.other]).to(torch.int32),
            "mask": torch.stack(score.mask),
            "boundary": score.boundary,
            "numbers": torch.tensor([area, best, score.seconds, score.trust], dtype=torch.float64),
        }
        confusions = {"layout": score.layout, "labels": score.labels}
        values |= {key: counts for key, counts in confusions.items() if counts is not None}
        row = len(self.images)
        for key in values.keys() - self.columns.keys():
            self.columns[key] = values[key].new_zeros((FIRST_ROWS, *values[key].shape))
        for key, column in self.columns.items():  # those as well that this image has not
            while len(column) <= row:
                column = torch.cat([column, torch.zeros_like(column)])
            if key in values:
                column[row] = values[key]
            self.columns[key] = column
        self.images.append((item.name, group))

    def kept(self, groups: Iterable[str] | None = None) -> Images:
        """What is kept of some groups' images, group by group, or of all in their order."""
        places = range(len(self.images))
        if groups is not None:
            places = [i for group in groups for i in places if self.images[i][1] == group]
        return self._rows(places)

    def named(self, names: Container[str]) -> Images:
        """What is kept of the images of these names, in their order."""
        return self._rows([i for i, (name, _) in enumerate(self.images) if name in names])

    def _rows(self, places: Sequence[int]) -> Images:
        chosen = torch.tensor(list(places), dtype=torch.int64)
        columns = {key: column[chosen] for key, column in self.columns.items()}
        return Images(
            [self.images[i][0] for i in places],
            [self.images[i][1] for i in places],
            RoadCounts(*columns["road"].unbind(1)),
            columns["mask"],
            columns["boundary"],
            columns.get("layout"),
            columns.get("labels"),
            *columns["numbers"].unbind(1),
        )


# --- what measures are taken of ---------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """Counts of some images together, or of many draws of them: then all have (draws,…).

    chosen: the outcome at the threshold of each group; None where there is none.
    image_auc: the mean of the single images' AUC, float64 (…).
    What follows in the list is not known of draws: labels, a confusion as ``layout``, of
    labels that may abstain; threshold, where there is one for all; the single images.
    """

    road: RoadCounts
    mask: Decisions
    boundary: Tensor
    layout: Tensor | None
    chosen: Decisions | None
    image_auc: Tensor
    labels: Tensor | None = None
    threshold: float | None = None
    images: Images | None = None

    @cached_property
    def max_f(self) -> tuple[Tensor, Tensor]:
        """KITTI's MaxF and its threshold, see ``metrics.max_f``."""
        return metrics.max_f(self.road)
