"""Differences between the masks of two methods: before and after further training."""

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

from roadtorch.base.errors import InputError, RoadtorchError
from roadtorch.base.image_cache import image_cache
from roadtorch.base.progress import Progress
from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.evaluation.methods import Contender, Predictor
from roadtorch.evaluation.result import Failure
from roadtorch.run.workers import WORKER_CRASH, make_workers


@dataclass(frozen=True)
class Disagreement:
    """Masks of two detectors on one image."""

    item: LabelledItem
    difference: float  # fraction of the pixels on which they differ
    first_road: float  # fraction of the pixels
    second_road: float
    first_trust: float = math.nan  # NaN where the detector gives none
    second_trust: float = math.nan

    @property
    def has_trust(self) -> bool:
        """Whether both detectors give a trust."""
        return not math.isnan(self.first_trust + self.second_trust)


@dataclass(frozen=True)
class Disagreements:
    """Masks of two methods on a set; images: the largest difference first, then by name."""

    dataset: Dataset
    methods: tuple[Contender, Contender]
    images: Sequence[Disagreement]
    failures: Sequence[Failure]


@dataclass(frozen=True)
class CompareTask:
    """Task of a worker process: the masks of two contenders on one image."""

    dataset: Dataset
    predictors: Sequence[Predictor]

    def __call__(self, item: LabelledItem) -> Disagreement | Failure:
        """Return the difference of the masks, or the failure of a contender."""
        try:
            image, _ = self.dataset.read(item)  # truth that cannot be read is a failure, too
            with image_cache():
                first, second = (predict(image, item) for predict in self.predictors)
        except RoadtorchError as error:
            return Failure(item.name, None, str(error))
        parts = (first.mask & ~second.mask, second.mask & ~first.mask, first.mask, second.mask)
        only_first, only_second, *roads = (float(part.double().mean()) for part in parts)
        trusts = (math.nan if side.trust is None else side.trust for side in (first, second))
        return Disagreement(item, only_first + only_second, *roads, *trusts)


def compare_masks(
    dataset: Dataset, methods: tuple[Contender, Contender], quiet: bool = False, **progress: str
) -> Disagreements:
    """Compare the masks of two methods on every image, each at its own threshold."""
    task = CompareTask(dataset, [contender.prepare(dataset) for contender in methods])
    results = make_workers(None, len(dataset.items)).map(task, dataset.items, _crash_failure)
    with closing(results):
        rows = [*Progress(results, total=len(dataset.items), unit="image", quiet=quiet, **progress)]
    images = [row for row in rows if isinstance(row, Disagreement)]
    images.sort(key=lambda pair: (-pair.difference, pair.item.name))
    failures = [row for row in rows if isinstance(row, Failure)]
    return Disagreements(dataset, methods, images, failures)


def _crash_failure(item: LabelledItem) -> Failure:
    return Failure(item.name, None, str(InputError(item.image, *WORKER_CRASH)))


# --- effect of further training: first is before, second is after -------------------------


def select_changed(ranked: Sequence[Disagreement], count: int) -> list[Disagreement]:
    """Select images to show: half have the largest difference, the others are evenly spread.

    ranked: the largest difference first. The spread covers the remaining ones, down to the smallest
    difference. All are selected where there are no more than ``count``.
    """
    if len(ranked) <= count:
        return list(ranked)
    largest, remaining = ranked[: count - count // 2], ranked[count - count // 2 :]
    steps = count // 2
    indices = ((step + 1) * len(remaining) // steps - 1 for step in range(steps))
    return [*largest, *(remaining[i] for i in indices)]
