"""Where two detectors disagree most, on pictures that nobody labelled."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.detector import Detection
from roadtorch.errors import DatasetError, RoadtorchError
from roadtorch.evaluation.contenders import Contender
from roadtorch.evaluation.result import Failure
from roadtorch.io.image import read_image
from roadtorch.runtime.image_cache import image_cache
from roadtorch.sources.pictures import Picture


@dataclass(frozen=True)
class Disagreement:
    """One picture as two see it.

    differs: share of the pixels on which the masks differ. first, second: road share of each.
    only_first, only_second: share of the pixels that one alone calls road.
    """

    item: Item
    differs: float
    first: float
    second: float
    only_first: float
    only_second: float


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


def disagreement(item: Item, first: Tensor, second: Tensor) -> Disagreement:
    """What two masks bool (H,W) of one picture differ in."""
    only_first, only_second = share_of(first & ~second), share_of(second & ~first)
    differs = only_first + only_second
    return Disagreement(item, differs, share_of(first), share_of(second), only_first, only_second)


def share_of(mask: Tensor) -> float:
    """The share of a mask bool (H,W) that is set."""
    return float(mask.double().mean())


def disagreements(
    dataset: Dataset, first: Contender, second: Contender
) -> Iterator[Disagreement | Failure]:
    """Each picture as two contenders decide on it, each at its own threshold; or why not."""
    for seen in seen_by_both(dataset, first, second):
        yield (
            seen
            if isinstance(seen, Failure)
            else disagreement(seen.item, seen.first.mask, seen.second.mask)
        )


class SeenByBoth(NamedTuple):
    """A picture and what two contenders found in it."""

    item: Item
    first: Detection
    second: Detection


def seen_by_both(
    dataset: Dataset, first: Contender, second: Contender
) -> Iterator[SeenByBoth | Failure]:
    """Each picture as two contenders see it, or why not."""
    looks = [one.prepare(dataset) for one in (first, second)]
    for item in dataset.items:
        try:
            image = read_image(item.image)
            with image_cache():
                one, other = (look(image, item) for look in looks)
            yield SeenByBoth(item, one, other)
        except RoadtorchError as problem:
            yield Failure(item.name, None, str(problem))


def worst_first(found: Sequence[Disagreement]) -> list[Disagreement]:
    """By the share of pixels that differ, the largest first, then by name."""
    return sorted(found, key=lambda one: (-one.differs, one.item.name))
