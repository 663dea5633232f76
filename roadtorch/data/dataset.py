"""What a labelled set of street images is.

A set is a list of items (paths), a reader of their truth and, where it is not scored in
the image itself, a view. Images and labels are read one at a time, so memory is flat
over any number of items.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from torch import Tensor

from roadtorch.base.errors import ConfigError, DatasetError, unknown_name
from roadtorch.base.image import read_image


@dataclass(frozen=True)
class Truth:
    """What is known about one image.

    road: bool (H,W). valid: bool (H,W), False where nothing is known (void).
    layout: uint8 (H,W), 0 sky, 1 vertical, 2 horizontal, 255 void; None if the set has none.
    """

    road: Tensor
    valid: Tensor
    layout: Tensor | None = None


@dataclass(frozen=True)
class LabelledItem:
    """One image with its label file.

    group: the camera, drive or city it is from, if known. extra: further files that its
    truth or view is made of, such as a calibration.
    conditions: under which it was taken, in words ("night", "rain").
    """

    name: str
    image: Path
    label: Path
    group: str | None = None
    extra: tuple[Path, ...] = ()
    conditions: tuple[str, ...] = ()


class TruthReader(Protocol):
    """Reads the truth of an item; a small frozen dataclass, for it travels to processes."""

    def truth(self, item: LabelledItem) -> Truth:
        """Read and check the item's label files; DatasetError naming the file."""
        ...


class View(Protocol):
    """Brings maps of an item's image into the space in which they are scored."""

    @property
    def name(self) -> str:
        """What the space is called in results."""
        ...

    def __call__(self, item: LabelledItem, values: Tensor) -> Tensor:
        """Turn maps (...,H,W) of any type into (...,h,w); what is unseen becomes 0 (False)."""
        ...


@dataclass(frozen=True)
class Dataset:
    """A labelled set that has been found complete: every image has its label file.

    levels: how many levels of likelihood are told apart in scoring (KITTI's program: 256).
    view: None for sets that are scored in the image itself.
    left_out: groups that are scored, but count in no mean and choose nothing.
    """

    name: str
    root: Path
    split: str
    items: tuple[LabelledItem, ...]
    reader: TruthReader = field(repr=False)
    levels: int = 65_536
    view: View | None = field(default=None, repr=False)
    left_out: frozenset[str] = frozenset()

    def groups(self) -> list[str]:
        """The groups, sorted; empty for a set that does not know them."""
        return sorted({item.group for item in self.items if item.group is not None})

    def by_condition(self) -> dict[str, list[LabelledItem]]:
        """The images of each condition, sorted by its name; without groups left out."""
        counting = [item for item in self.items if item.group not in self.left_out]
        names = sorted({name for item in counting for name in item.conditions})
        return {name: [item for item in counting if name in item.conditions] for name in names}

    def truth(self, item: LabelledItem) -> Truth:
        """Read the truth of one item, in the image's own space."""
        return self.reader.truth(item)

    def read(self, item: LabelledItem) -> tuple[Tensor, Truth]:
        """Read image (3,H,W) and truth; DatasetError when their sizes differ."""
        image, truth = read_image(item.image), self.truth(item)
        if image.shape[1:] != truth.road.shape:
            (height, width), (rows, columns) = image.shape[1:], truth.road.shape
            message = f"is {columns} by {rows} pixels, its image {width} by {height}"
            raise DatasetError(item.label, message, "labels must have the size of the image")
        return image, truth


def every_kth(dataset: Dataset, limit: int | None) -> Dataset:
    """At most ``limit`` items of a set, spread evenly over it."""
    if limit is None or limit >= len(dataset.items):
        return dataset
    step = len(dataset.items) / limit
    return replace(dataset, items=tuple(dataset.items[int(index * step)] for index in range(limit)))


def leave_out(dataset: Dataset, groups: Iterable[str]) -> Dataset:
    """The set with some groups left out of means and choices; they are scored all the same.

    Raises ConfigError for a group that it does not have, and when none is left.
    """
    left_out, known = frozenset(groups), dataset.groups()
    if left_out and not known:
        message = f"is not for {dataset.name} at {dataset.root}, which has no groups"
        raise ConfigError("--leave-out", message, "leave it out")
    for name in sorted(left_out - set(known)):
        raise unknown_name(f"group of {dataset.name}", name, known)
    if left_out and left_out == set(known):
        raise ConfigError("--leave-out", "leaves out every group", "keep one at least")
    return replace(dataset, left_out=left_out)


@dataclass(frozen=True)
class Kind:
    """A layout of files that can be opened.

    splits: their names, the default first. open: makes the set from its folder and the name
    of a split; raises DatasetError for an incomplete one.
    """

    splits: tuple[str, ...]
    open: Callable[[Path, str], Dataset]
