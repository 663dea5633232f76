"""Labelled data sets of street images.

A data set is a list of items (paths), a reader of their ground truth and, where scores are not
computed in image space, a mapping into the space of the scores. Images and labels are read one at
a time, so memory does not grow with the number of items.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from torch import Tensor

from roadtorch.base.errors import ConfigError, DatasetError, unknown_name_error
from roadtorch.base.image import read_image


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of one image.

    Attributes:
        road: bool, shape (H, W).
        valid: bool, shape (H, W); False in void pixels, which are not scored.
        layout: uint8, shape (H, W): 0 sky, 1 vertical, 2 horizontal, 255 void; None without one.
    """

    road: Tensor
    valid: Tensor
    layout: Tensor | None = None


@dataclass(frozen=True)
class LabelledItem:
    """One image with its label file.

    Attributes:
        group: the camera, drive or city, if known.
        extra: further files of its ground truth or scoring space, such as a calibration.
        conditions: words such as "night" or "rain".
    """

    name: str
    image: Path
    label: Path
    group: str | None = None
    extra: tuple[Path, ...] = ()
    conditions: tuple[str, ...] = ()


class TruthReader(Protocol):
    """Reader of an item's ground truth; a small frozen dataclass, since processes pickle it."""

    def truth(self, item: LabelledItem) -> Truth:
        """Read and check the item's label files; DatasetError naming the file."""
        ...


class ScoringSpace(Protocol):
    """Mapping of an image's maps into the space in which they are scored."""

    @property
    def name(self) -> str:
        """Name of the space in results."""
        ...

    def __call__(self, item: LabelledItem, values: Tensor) -> Tensor:
        """Map values (..., H, W) of any dtype to (..., h, w); invisible cells become 0 (False)."""
        ...


@dataclass(frozen=True)
class Dataset:
    """Labelled data set in which every image has its label file.

    Attributes:
        reader: reads the ground truth of an item.
        levels: number of levels to which scoring rounds likelihoods (KITTI's program: 256).
        scoring_space: maps results into the space of the scores; None for the image itself.
        left_out: groups that are scored, but enter no mean and choose no threshold.
        summary: lines that say what was taken for road, where the files' values decide it.
    """

    name: str
    root: Path
    split: str
    items: tuple[LabelledItem, ...]
    reader: TruthReader = field(repr=False)
    levels: int = 65_536
    scoring_space: ScoringSpace | None = field(default=None, repr=False)
    left_out: frozenset[str] = frozenset()
    summary: str = ""

    @property
    def space_name(self) -> str:
        """Name of the space in which the set is scored."""
        return self.scoring_space.name if self.scoring_space else "the image"

    def groups(self) -> list[str]:
        """Return the groups, sorted; an empty list if the data set has none."""
        return sorted({item.group for item in self.items if item.group is not None})

    def items_by_condition(self) -> dict[str, list[LabelledItem]]:
        """Return the items of each condition, by its name, sorted; without the groups left out."""
        counting = [item for item in self.items if item.group not in self.left_out]
        names = sorted({name for item in counting for name in item.conditions})
        return {name: [item for item in counting if name in item.conditions] for name in names}

    def truth(self, item: LabelledItem) -> Truth:
        """Read the ground truth of one item, in image space."""
        return self.reader.truth(item)

    def read(self, item: LabelledItem) -> tuple[Tensor, Truth]:
        """Read the image, shape (3, H, W), and the ground truth of one item.

        Raises:
            DatasetError: when a file cannot be read, or their sizes differ.
        """
        image, truth = read_image(item.image), self.truth(item)
        if image.shape[1:] != truth.road.shape:
            (height, width), (rows, columns) = image.shape[1:], truth.road.shape
            message = f"is {columns} by {rows} pixels, its image {width} by {height}"
            raise DatasetError(item.label, message, "labels must have the size of the image")
        return image, truth

    def warp(self, item: LabelledItem, size: tuple[int, int], values: Tensor) -> Tensor:
        """Map values (..., H, W), if of the image's size, to the space of the scores."""
        space = self.scoring_space
        return space(item, values) if space and tuple(values.shape[-2:]) == size else values


def subsample_dataset(dataset: Dataset, limit: int | None) -> Dataset:
    """Return the data set with at most ``limit`` of its items, evenly spaced; all for None."""
    if limit is None or limit >= len(dataset.items):
        return dataset
    step = len(dataset.items) / limit
    return replace(dataset, items=tuple(dataset.items[int(index * step)] for index in range(limit)))


def leave_out(dataset: Dataset, groups: Iterable[str]) -> Dataset:
    """Return the data set with groups that enter no mean and choose no threshold; they are scored.

    Raises:
        ConfigError: for an unknown group, and when no group is left.
    """
    left_out, all_groups = frozenset(groups), dataset.groups()
    if left_out and not all_groups:
        message = f"is not for {dataset.name} at {dataset.root}, which has no groups"
        raise ConfigError("--leave-out", message, "leave it out")
    for name in sorted(left_out - set(all_groups)):
        raise unknown_name_error(f"group of {dataset.name}", name, all_groups)
    if left_out and left_out == set(all_groups):
        raise ConfigError("--leave-out", "leaves out every group", "keep at least one")
    return replace(dataset, left_out=left_out)


@dataclass(frozen=True)
class DatasetFormat:
    """File layout of a data set and the function that opens it.

    Attributes:
        splits: names of the splits, the default first.
        open: opens a folder and the name of a split; raises DatasetError for an incomplete one.
    """

    splits: tuple[str, ...]
    open: Callable[..., Dataset]
