"""The streets that P2's figures are drawn on, what detectors find there, and how it is shown."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, Item, every_kth
from roadtorch.detector import Detection
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import metrics
from roadtorch.evaluation.methods import Look
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.evaluation.scoring import score_item
from roadtorch.io.atomic import csv_text, write_text
from roadtorch.io.image import write_colours
from roadtorch.report.montage import TILE_WIDTH, captioned
from roadtorch.report.screen import align

EVERY = 16
"""Figures look at every so-manieth picture."""


class Counts(NamedTuple):
    """What one detector found on some pictures, their pixels added up.

    layout: the confusion int64 (4,4), None for a detector without one.
    """

    road: RoadCounts
    mask: Decisions
    layout: Tensor | None


Found = Mapping[str, Mapping[str, Counts]]
"""By detector and drive."""


def streets(data: Path, every: int = EVERY) -> Dataset:
    """CamVid's test split, which P2's figures show, where ``data`` has it; else its dev drives."""
    root = data / "camvid"
    split = "test" if (root / "test").is_dir() else "dev"
    dataset = open_dataset("camvid", root, split)
    chosen = every_kth(dataset, -(-len(dataset.items) // every))
    print(f"CamVid {split}, {len(chosen.items)} of {len(dataset.items)} pictures", end="\n\n")
    return chosen


def look_of(name: str, settings: Mapping[str, Any] | None = None) -> Look:
    """How a detector with some settings looks at an item."""
    detector = load_detector(name, **(settings or {}))

    def look(image: torch.Tensor, item: Item) -> Detection:
        return detector.detect(image)

    return look


def found_on(dataset: Dataset, looks: Mapping[str, Look]) -> Found:
    """What every detector finds, by drive. RuntimeError for a picture that fails."""
    found: dict[str, dict[str, Counts]] = {name: {} for name in looks}
    for item in tqdm(dataset.items, unit="image", disable=None):
        scored = score_item(dataset, looks, item)
        if scored.failure:
            raise RuntimeError(f"{item.name}: {scored.failure}")
        for name, score in scored.scores.items():
            own, drive = Counts(score.road, score.mask, score.layout), item.group or dataset.name
            drives = found[name]
            drives[drive] = together([drives[drive], own]) if drive in drives else own
    return found


def together(parts: Iterable[Counts]) -> Counts:
    """The pixels of all parts: what P2 pools over a whole set."""
    roads, masks, layouts = zip(*parts, strict=True)
    known = None if any(one is None for one in layouts) else reduce(add, layouts)
    return Counts(reduce(add, roads), reduce(add, masks), known)


def pooled(drives: Mapping[str, Counts]) -> Counts:
    """The pixels of all drives together."""
    return together(drives.values())


def mean_over_drives(drives: Mapping[str, Counts], figure: Callable[[Counts], Tensor]) -> float:
    """The mean of a figure over drives."""
    return float(torch.stack([figure(counts) for counts in drives.values()]).mean())


def auc(counts: Counts) -> Tensor:
    """Area under the ROC curve."""
    return metrics.auc(counts.road)


def tell(rows: Sequence[Mapping[str, str]], path: Path) -> None:
    """Print a table and write it as CSV."""
    write_text(path, csv_text(list(rows[0]), rows))
    print(align([list(rows[0]), *(list(row.values()) for row in rows)]))


def shown_items(dataset: Dataset, count: int = 5) -> tuple[Item, ...]:
    """Some pictures, spread evenly over a set."""
    return every_kth(dataset, count).items


def write_sheet(
    columns: Sequence[Mapping[str, np.ndarray]], path: Path, tile: int = TILE_WIDTH
) -> None:
    """Write tiles uint8 (H,W,3) by row title, a column for each picture, as a PNG."""
    stacks = []
    for column in columns:
        first = next(iter(column.values()))
        height = round(first.shape[0] * tile / first.shape[1])
        stacks.append(
            np.concatenate([captioned(one, text, height) for text, one in column.items()])
        )
    sheet = np.concatenate(stacks, axis=1)
    write_colours(path, torch.from_numpy(sheet.transpose(2, 0, 1).astype(np.float32) / 255))
    print(path)
