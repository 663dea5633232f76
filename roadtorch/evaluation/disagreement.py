"""What two methods decide differently on unlabelled images: before and after further training."""

import math
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from roadtorch.base.errors import DatasetError, InputError, RoadtorchError
from roadtorch.base.image import read_image
from roadtorch.base.image_cache import image_cache
from roadtorch.base.progress import Progress
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.evaluation.methods import Contender, Look
from roadtorch.evaluation.result import Failure
from roadtorch.inputs.item import Item
from roadtorch.run.workers import DIED, workers_for


@dataclass(frozen=True)
class Disagreement:
    """One image as two see it.

    differs: fraction of the pixels on which the masks differ. first, second: fraction of road of
    each. first_trust, second_trust: NaN where the detector has none.
    """

    item: LabelledItem
    differs: float
    first: float
    second: float
    first_trust: float = math.nan
    second_trust: float = math.nan

    @property
    def has_trust(self) -> bool:
        """Whether both detectors say how far they trust their masks."""
        return not math.isnan(self.first_trust + self.second_trust)


@dataclass(frozen=True)
class Unlabelled:
    """The reader of a set without labels."""

    def truth(self, item: LabelledItem) -> Truth:
        """Always raises DatasetError."""
        raise DatasetError(item.image, "has no label", "give a labelled set")


def unlabelled_set(images: Iterable[Item]) -> Dataset:
    """Images as a set whose truth nobody knows."""
    items = tuple(LabelledItem(image.name, image.path, image.path) for image in images)
    return Dataset("images", Path(), "", items, Unlabelled())


@dataclass(frozen=True)
class Disagreements:
    """Two methods on a set without labels. images: those that differ most first, then by name."""

    dataset: Dataset
    methods: tuple[Contender, Contender]
    images: Sequence[Disagreement]
    failures: Sequence[Failure]


@dataclass(frozen=True)
class Comparing:
    """The task of workers: two contenders decide on one image."""

    looks: Sequence[Look]

    def __call__(self, item: LabelledItem) -> Disagreement | Failure:
        """Return how they differ, or why one of them says nothing."""
        try:
            image = read_image(item.image)
            with image_cache():
                first, second = (look(image, item) for look in self.looks)
        except RoadtorchError as error:
            return Failure(item.name, None, str(error))
        parts = (first.mask & ~second.mask, second.mask & ~first.mask, first.mask, second.mask)
        only_first, only_second, *roads = (float(part.double().mean()) for part in parts)
        trusts = (
            math.nan if detection.trust is None else detection.trust
            for detection in (first, second)
        )
        return Disagreement(item, only_first + only_second, *roads, *trusts)


def disagreements(
    dataset: Dataset,
    methods: tuple[Contender, Contender],
    jobs: int | None = None,
    quiet: bool = False,
    **bar: str,
) -> Disagreements:
    """Every image as two methods decide on it, each at its own threshold.

    jobs: processes, None for what pays. bar: what else ``Progress`` is told.
    """
    task = Comparing([contender.prepare(dataset) for contender in methods])
    items = dataset.items
    results = workers_for(jobs, len(items)).map(task, items, _died)
    images, failures = list[Disagreement](), list[Failure]()
    with closing(results):
        for result in Progress(results, total=len(items), unit="image", quiet=quiet, **bar):
            if isinstance(result, Failure):
                failures.append(result)
            else:
                images.append(result)
    images.sort(key=lambda pair: (-pair.differs, pair.item.name))
    return Disagreements(dataset, methods, images, failures)


def _died(item: LabelledItem) -> Failure:
    return Failure(item.name, None, str(InputError(item.image, *DIED)))


# --- what further training changed: first is before, second is after ----------------------


class Agreement(NamedTuple):
    """Shares of the pixels, where the teacher is sure, on which a network says the same.

    layout: the class; road: road or not. images: how many were asked.
    """

    layout: float
    road: float
    images: int


class Taught(NamedTuple):
    """The teacher's name, and how far the network agreed with it before, and does now."""

    teacher: str
    before: Agreement
    after: Agreement


def most_and_spread(ranked: Sequence[Disagreement], count: int) -> list[Disagreement]:
    """So many images to look at: half of them changed most, the others are evenly spread.

    ranked: the most changed first. The spread is over what is left, from much changed to little,
    the least changed included. All where there are no more than ``count``.
    """
    if len(ranked) <= count:
        return list(ranked)
    most, rest = ranked[: count - count // 2], ranked[count - count // 2 :]
    steps = count // 2
    return [*most, *(rest[(place + 1) * len(rest) // steps - 1] for place in range(steps))]
