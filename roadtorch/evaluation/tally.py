"""Counts of an evaluation: sums by group, and a few numbers of each image.

The sums have one size whatever the number of images. Of each image the 8-bit histograms are kept
(2 kB), for distributions, intervals and comparisons.
"""

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from operator import add

import numpy as np
import torch
from torch import Tensor

from roadtorch.data.dataset import LabelledItem
from roadtorch.evaluation import metrics
from roadtorch.evaluation.boundary import TOLERANCES
from roadtorch.evaluation.metrics import ConfusionCounts, RoadCounts

UNGROUPED = "all"  # name of the only group of a set without groups
IMAGE_LEVELS = 256  # levels of the histograms of single images

ROW = np.dtype([
    ("road", np.int32, (2, IMAGE_LEVELS)),
    ("mask", np.int64, 4),
    ("boundary", np.int64, (len(TOLERANCES), 4)),
    ("layout", np.int64, (4, 4)),
    ("numbers", np.float64, 4),
])  # fmt: skip
"""Counts of an image: 8-bit levels of road and background, outcomes of the mask, boundary, layout;
then AUC, MaxF, seconds, trust."""


@dataclass(frozen=True, eq=False)
class ImageCounts:
    """Counts of one detector on one image, in the space of the truth."""

    road: RoadCounts
    mask: ConfusionCounts
    boundary: Tensor  # int64 (tolerances, 4), see boundary.py
    layout: Tensor | None  # confusion (4, 4) of the strongest potentials
    seconds: float = math.nan  # of detection, with the parts that were cached for it
    trust: float = math.nan  # predicted F of the mask; NaN where the detector gives none


@dataclass(frozen=True, eq=False)
class ImageTable:
    """Counts of n images: a row of every tensor is one image."""

    names: Sequence[str]
    groups: Sequence[str]
    road: RoadCounts  # int32 (n, IMAGE_LEVELS)
    outcomes: Tensor  # int64 (n, 4), the fields of ConfusionCounts
    boundary: Tensor  # int64 (n, tolerances, 4)
    layout: Tensor | None  # int64 (n, 4, 4), zeros where an image has none
    auc: Tensor  # float64 (n,), NaN without road or background
    max_f: Tensor  # float64 (n,), NaN without road
    seconds: Tensor  # float64 (n,)
    trust: Tensor  # float64 (n,), NaN where the detector gives none

    @property
    def mask(self) -> ConfusionCounts:
        """Counts of the masks, int64 (n,) each."""
        return ConfusionCounts(*self.outcomes.unbind(1))

    def group_mask(self, group: str) -> Tensor:
        """Return which of the images are of a group, bool (n,)."""
        return torch.tensor([name == group for name in self.groups], dtype=torch.bool)


@dataclass(eq=False)
class Tally:
    """Counts of one detector: pixels by likelihood and group, and a row of each image.

    The rows are bytes of ``ROW``: thousands of small tensors between the large temporary ones of
    counting would fragment the memory.
    """

    road: dict[str, RoadCounts] = field(default_factory=dict)
    keys: list[tuple[str, str]] = field(default_factory=list)  # name and group of each row
    rows: bytearray = field(default_factory=bytearray, repr=False)

    def add(self, item: LabelledItem, score: ImageCounts) -> None:
        """Add the counts of one image."""
        group = item.group or UNGROUPED
        self.road[group] = self.road[group] + score.road if group in self.road else score.road
        self.keys.append((item.name, group))
        coarse, row = metrics.coarsen(score.road, IMAGE_LEVELS), np.zeros((), ROW)
        row["road"] = torch.stack([coarse.road, coarse.background])
        row["mask"], row["boundary"] = torch.stack(score.mask), score.boundary
        row["layout"] = 0 if score.layout is None else score.layout
        area, best = float(metrics.auc(score.road)), float(metrics.max_f(score.road)[0])
        row["numbers"] = area, best, score.seconds, score.trust
        self.rows += row.tobytes()

    def table(
        self, groups: Iterable[str] | None = None, names: Container[str] | None = None
    ) -> ImageTable:
        """Return the images of some groups, group by group, or of some names, in their order."""
        indices = range(len(self.keys))
        if groups is not None:
            indices = [i for group in groups for i in indices if self.keys[i][1] == group]
        if names is not None:
            indices = [i for i in indices if self.keys[i][0] in names]
        rows = np.frombuffer(self.rows, ROW)[np.array(indices, np.int64)]
        road, mask, boundary, layout, numbers = (
            torch.from_numpy(np.ascontiguousarray(rows[name])) for name in ROW.fields or ()
        )
        return ImageTable(
            [self.keys[i][0] for i in indices],
            [self.keys[i][1] for i in indices],
            RoadCounts(*road.unbind(1)),
            mask,
            boundary,
            layout if layout.any() else None,
            *numbers.unbind(1),
        )


# --- pooled counts ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PooledCounts:
    """Pooled counts of images, or of bootstrap replicates of them: then shape (replicates, …)."""

    road: RoadCounts
    mask: ConfusionCounts
    boundary: Tensor
    layout: Tensor | None
    at_threshold: ConfusionCounts  # at the threshold of each group; zeros where there is none
    image_auc: Tensor  # mean of the AUCs of single images, float64 (…)
    threshold: float | None = None  # where all groups share one; replicates lack it
    images: ImageTable | None = None  # replicates lack them

    @cached_property
    def max_f(self) -> tuple[Tensor, Tensor]:
        """KITTI's MaxF and its threshold, see ``metrics.max_f``."""
        return metrics.max_f(self.road)


def pool(
    images: ImageTable,
    thresholds: Mapping[str, float],
    weights: Tensor | None = None,
    road: Mapping[str, RoadCounts] | None = None,
) -> PooledCounts:
    """Add up the counts of images.

    thresholds: of their groups, NaN for none. weights: how often each image counts in each
    replicate, (replicates, n). road: pixels by level of each group; by default from 8-bit maps.
    """
    weights = None if weights is None else weights.to(torch.float64)

    def total(counts: Tensor, members: Tensor | slice = slice(None)) -> Tensor:
        if weights is None:
            return counts[members].sum(0)
        flat = weights[:, members] @ counts[members].flatten(1).to(torch.float64)
        return flat.reshape(-1, *counts.shape[1:])

    road = road or {
        group: RoadCounts(*(total(part, members).round().to(torch.int64) for part in parts))
        for parts in [(images.road.road, images.road.background)]
        for group in dict.fromkeys(images.groups)
        for members in [images.group_mask(group)]
    }
    whole, areas = reduce(add, road.values()), images.auc[~images.auc.isnan()]
    if weights is None:
        mean = sum(areas.tolist()) / len(areas) if len(areas) else math.nan
        area = torch.tensor(mean, dtype=torch.float64)
    else:
        counted = weights[:, ~images.auc.isnan()]
        area = (counted @ areas) / counted.sum(1)
    defined = {group: value for group, value in thresholds.items() if not math.isnan(value)}
    none = ConfusionCounts(*torch.zeros(4, *whole.road.shape[:-1], dtype=torch.int64))
    return PooledCounts(
        whole,
        ConfusionCounts(*total(images.outcomes).unbind(-1)),
        total(images.boundary),
        None if images.layout is None else total(images.layout),
        reduce(add, (metrics.confusion_at(road[group], defined[group]) for group in defined), none),
        area,
        images=images if weights is None else None,
    )
