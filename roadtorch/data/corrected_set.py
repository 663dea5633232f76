"""Corrected pictures as a labelled set: what people said is the truth, all else is void."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import torch

from roadtorch.data.correction_labels import NOT_ROAD, ROAD_SAID
from roadtorch.data.corrections import corrected, journals_by_picture, read_corrections
from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.data.journal import read_journal
from roadtorch.errors import DatasetError
from roadtorch.layout.classes import UNLABELLED


@dataclass(frozen=True)
class JournalLabels:
    """The truth in the journals of a picture: the item's label, and those of further people."""

    def truth(self, item: Item) -> Truth:
        """What people said; DatasetError for a journal that cannot be read."""
        journals = [(path, read_journal(path)) for path in (item.label, *item.extra)]
        found = corrected(item.image, item.name, journals)
        road, layout = torch.from_numpy(found.road), torch.from_numpy(found.layout)
        valid = (road == ROAD_SAID) | (road == NOT_ROAD)
        return Truth(road == ROAD_SAID, valid, layout if (layout != UNLABELLED).any() else None)


def open_corrections(folder: Path, pictures: Path | None = None) -> Dataset:
    """The corrected pictures of which the road of some pixel was said, in the order of their names.

    folder, pictures: see ``read_corrections``, which says what is raised; DatasetError too where
    nobody said anything of the road.
    """
    journals = journals_by_picture(folder)
    items = []
    for one in read_corrections(folder, pictures):
        if ((one.road == ROAD_SAID) | (one.road == NOT_ROAD)).any():
            label, *extra = [path for path, _ in journals[one.name]]
            name = PurePosixPath(one.name).with_suffix("").as_posix()
            items.append(Item(name, one.picture, label, None, tuple(extra)))
    if not items:
        raise DatasetError(folder, "says nothing of the road", "correct some pictures")
    return Dataset("corrections", folder, "all", tuple(items), JournalLabels())
