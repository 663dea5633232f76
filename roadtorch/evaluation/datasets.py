"""Labelled sets of street pictures by name: what a set is, and the one door to all of them.

A set is a list of items (paths), a reader of their truth and, where it is not scored in
the picture itself, a view. Pictures and labels are read one at a time, so memory is flat
over any number of items. The sets that come with roadtorch are in ``sets``; other packages
add theirs through the entry-point group ``roadtorch.datasets``: the entry point's name is
the set's, and it names a ``Kind``.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Protocol

from torch import Tensor

from roadtorch.errors import ConfigError, DatasetError, unknown_name
from roadtorch.image import read_image

ENTRY_POINT_GROUP = "roadtorch.datasets"
SKY, VERTICAL, HORIZONTAL, NONE = 0, 1, 2, 255  # layout classes, and pixels without one


@dataclass(frozen=True)
class Truth:
    """What is known about one picture.

    road: bool (H,W). valid: bool (H,W), False where nothing is known (void).
    layout: uint8 (H,W), 0 sky, 1 vertical, 2 horizontal, 255 void; None if the set has none.
    """

    road: Tensor
    valid: Tensor
    layout: Tensor | None = None


@dataclass(frozen=True)
class Item:
    """One picture with its label file.

    group: the drive (city, category) it is from, if known. extra: further files that its
    truth or view is made of, such as other people's annotations or a calibration.
    """

    name: str
    image: Path
    label: Path
    group: str | None = None
    extra: tuple[Path, ...] = ()


class TruthReader(Protocol):
    """Reads the truth of an item; a small frozen dataclass, for it travels to processes."""

    def truth(self, item: Item) -> Truth:
        """Read and check the item's label files; DatasetError naming the file."""
        ...


class View(Protocol):
    """Brings maps of an item's picture into the space in which they are scored."""

    @property
    def name(self) -> str:
        """What the space is called in results."""
        ...

    def __call__(self, item: Item, values: Tensor) -> Tensor:
        """Turn maps (...,H,W) of any type into (...,h,w); what is unseen becomes 0 (False)."""
        ...


@dataclass(frozen=True)
class Dataset:
    """A labelled set that has been found complete: every picture has its label file.

    levels: how many levels of likelihood are told apart in scoring (KITTI's program: 256).
    view: None for sets that are scored in the picture itself.
    """

    name: str
    root: Path
    split: str
    items: tuple[Item, ...]
    reader: TruthReader = field(repr=False)
    levels: int = 65_536
    view: View | None = field(default=None, repr=False)

    def groups(self) -> list[str]:
        """The drives, sorted; empty for a set that does not know them."""
        return sorted({item.group for item in self.items if item.group is not None})

    def truth(self, item: Item) -> Truth:
        """Read the truth of one item, in the picture's own space."""
        return self.reader.truth(item)

    def read(self, item: Item) -> tuple[Tensor, Truth]:
        """Read image (3,H,W) and truth; DatasetError when their sizes differ."""
        image, truth = read_image(item.image), self.truth(item)
        if image.shape[1:] != truth.road.shape:
            (height, width), (rows, columns) = image.shape[1:], truth.road.shape
            what = f"is {columns} by {rows} pixels, its picture {width} by {height}"
            raise DatasetError(item.label, what, "labels must have the size of the picture")
        return image, truth


@dataclass(frozen=True)
class Kind:
    """A layout of files that can be opened.

    splits: their names, the default first. open: makes the set from its folder and the name
    of a split; raises DatasetError for an incomplete one.
    """

    splits: tuple[str, ...]
    open: Callable[[Path, str], Dataset]


def open_dataset(name: str, root: Path, split: str | None = None) -> Dataset:
    """Open a labelled set; without ``split`` its default one.

    Raises ConfigError for an unknown name or split, DatasetError for an incomplete or
    empty set.
    """
    kind = dataset_kind(name)
    if split is not None and split not in kind.splits:
        raise unknown_name(f"split of {name}", split, kind.splits)
    if not root.is_dir():
        raise DatasetError(root, "is not a folder", f"give the folder that holds {name}")
    split = split or kind.splits[0]
    dataset = kind.open(root, split)
    if not dataset.items:
        raise DatasetError(root, f"holds no pictures of the split {split}", "choose another split")
    return dataset


def list_datasets() -> list[str]:
    """The names of all sets, sorted; those of other packages among them."""
    return sorted(_catalogue())


def dataset_kind(name: str) -> Kind:
    """The kind of one set; ConfigError with the nearest names if there is none."""
    kinds = _catalogue()
    if name not in kinds:
        raise unknown_name("data set", name, kinds)
    return kinds[name]


@cache
def _catalogue() -> dict[str, Kind]:
    # The sets need Dataset from this module, hence the late import.
    from roadtorch.evaluation.sets import KINDS

    kinds = dict(KINDS)
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name):
        _add_foreign(kinds, point)
    return kinds


def _add_foreign(kinds: dict[str, Kind], point: EntryPoint) -> None:
    """Add another package's set; a broken package costs only its own."""
    try:
        if point.name in kinds:
            raise ConfigError(point.name, "is the name of another set", "choose a new name")
        kind = point.load()
        if not isinstance(kind, Kind):
            raise ConfigError(point.value, f"is {type(kind).__name__}", "name a Kind")
        kinds[point.name] = kind
    except Exception as problem:
        package = point.dist.name if point.dist else point.value
        message = f"data set {point.name!r} of {package} cannot be used: {problem}"
        warnings.warn(message, RuntimeWarning, stacklevel=2)
