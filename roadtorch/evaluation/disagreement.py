"""What two methods decide differently on unlabelled pictures: A and B, or before and after."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.errors import DatasetError, RoadtorchError
from roadtorch.evaluation.methods import Method
from roadtorch.evaluation.result import Failure
from roadtorch.io.image import read_image
from roadtorch.runtime.image_cache import image_cache
from roadtorch.runtime.progress import Progress
from roadtorch.sources.pictures import Picture


@dataclass(frozen=True)
class Disagreement:
    """One picture as two see it.

    differs: share of the pixels on which the masks differ. first, second: road share of each.
    only_first, only_second: share of the pixels that one alone calls road. first_trust,
    second_trust: NaN where the detector has none.
    """

    item: Item
    differs: float
    first: float
    second: float
    only_first: float
    only_second: float
    first_trust: float = math.nan
    second_trust: float = math.nan

    @property
    def iou(self) -> float:
        """What both call road, of what either does; 1 where neither finds any."""
        either = self.first + self.only_second
        return (self.first - self.only_first) / either if either else 1.0

    @property
    def has_trust(self) -> bool:
        """Whether both detectors say how far they trust their masks."""
        return not math.isnan(self.first_trust + self.second_trust)


@dataclass(frozen=True)
class Unlabelled:
    """The reader of a set without labels."""

    def truth(self, item: Item) -> Truth:
        """Always raises DatasetError."""
        raise DatasetError(item.image, "has no label", "give a labelled set")


def unlabelled_set(pictures: Iterable[Picture]) -> Dataset:
    """Pictures as a set whose truth nobody knows."""
    items = tuple(Item(one.name, one.path, one.path) for one in pictures)
    return Dataset("pictures", Path(), "", items, Unlabelled())


@dataclass(frozen=True)
class Disagreements:
    """Two methods on a set without labels. pictures: those that differ most first, then by name."""

    dataset: Dataset
    methods: tuple[Method, Method]
    pictures: Sequence[Disagreement]
    failures: Sequence[Failure]


def disagreements(
    dataset: Dataset, methods: tuple[Method, Method], quiet: bool = False, **bar: str
) -> Disagreements:
    """Every picture as two methods decide on it, each at its own threshold.

    bar: what else ``Progress`` is told.
    """
    looks = [one.prepare(dataset) for one in methods]
    pictures, failures = list[Disagreement](), list[Failure]()
    for item in Progress(dataset.items, unit="image", quiet=quiet, **bar):
        try:
            image = read_image(item.image)
            with image_cache():
                one, other = (look(image, item) for look in looks)
        except RoadtorchError as problem:
            failures.append(Failure(item.name, None, str(problem)))
            continue
        trusts = [math.nan if each.trust is None else each.trust for each in (one, other)]
        pictures.append(disagreement(item, one.mask, other.mask, *trusts))
    pictures.sort(key=lambda one: (-one.differs, one.item.name))
    return Disagreements(dataset, methods, pictures, failures)


def disagreement(item: Item, first: Tensor, second: Tensor, *trusts: float) -> Disagreement:
    """What two masks bool (H,W) of one picture differ in; trusts: of both, if they are known."""
    shares = [
        float(mask.double().mean()) for mask in (first, second, first & ~second, second & ~first)
    ]
    return Disagreement(item, shares[2] + shares[3], *shares, *trusts)


# --- what further training changed: first is before, second is after ----------------------


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


def most_and_spread(ranked: Sequence[Disagreement], count: int) -> list[Disagreement]:
    """So many pictures to look at: half of them changed most, the others are evenly spread.

    ranked: the most changed first. The spread is over what is left, from much changed to little,
    the least changed included. All where there are no more than ``count``.
    """
    if len(ranked) <= count:
        return list(ranked)
    most, rest = ranked[: count - count // 2], ranked[count - count // 2 :]
    steps = count // 2
    return [*most, *(rest[(place + 1) * len(rest) // steps - 1] for place in range(steps))]
