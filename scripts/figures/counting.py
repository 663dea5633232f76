"""Counts of detectors on a labelled set, image by image and resumable, and intervals of scores."""

import math
import pickle
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.base.atomic import atomic_write
from roadtorch.base.progress import Progress
from roadtorch.data.dataset import Dataset
from roadtorch.evaluation.methods import Contender, collect_contenders
from roadtorch.evaluation.result import pool_groups
from roadtorch.evaluation.scoring import score_dataset
from roadtorch.evaluation.tally import ImageResult, PooledCounts, Tally
from roadtorch.evaluation.uncertainty import (
    BOOTSTRAP_SEED,
    bootstrap_weights,
    percentile_interval,
    pool_replicates,
    student_weights,
)

REPORT = 40  # images between two yields
Tallies = Mapping[str, Tally]


def count_images(
    dataset: Dataset, contenders: Sequence[str | Contender], folder: Path
) -> Iterator[tuple[int, Tallies]]:
    """Yield how many images are counted, and the counts, after ``REPORT`` images and at the end.

    Counts of an image are kept in ``folder``, from which the next run resumes; the figure removes
    it. RuntimeError for an image that fails.
    """
    entries = collect_contenders(dataset, contenders, {}, with_baselines=False)
    folder.mkdir(parents=True, exist_ok=True)
    tallies = {entry.name: Tally() for entry in entries}
    paths = {item.name: folder / f"{item.name.replace('/', '-')}.pickle" for item in dataset.items}
    kept = {name for name, path in paths.items() if _read_counts(path, tallies)}
    missing = tuple(item for item in dataset.items if item.name not in kept)
    fresh = score_dataset(replace(dataset, items=missing), entries)
    for number, item in enumerate(Progress(dataset.items, unit="image"), 1):
        path = paths[item.name]
        result = _read_counts(path, tallies) if item.name in kept else None
        result = result or _write_counts(path, next(fresh))
        for name, counts in result.counts.items():
            tallies[name].add(item, counts)
        if number % REPORT == 0 or number == len(dataset.items):
            yield number, tallies


def _read_counts(path: Path, names: Collection[str]) -> ImageResult | None:
    """Read the counts of an image; None where there are none, or of other contenders."""
    result = pickle.loads(path.read_bytes()) if path.exists() else None
    return result if result is not None and set(result.counts) == set(names) else None


def _write_counts(path: Path, result: ImageResult) -> ImageResult:
    """Write the counts of an image and return them; RuntimeError where it failed."""
    if result.failure:
        raise RuntimeError(f"{result.item.name}: {result.failure}")
    with atomic_write(path) as temporary:
        temporary.write_bytes(pickle.dumps(result))
    return result


# --- intervals --------------------------------------------------------------------------


class Replicates(NamedTuple):
    """Counts pooled over drives, and of each drive with its weights.

    Either those of all images, or of bootstrap replicates, (replicates, …).
    """

    pooled: PooledCounts
    drives: Sequence[tuple[Tensor, PooledCounts]]

    def mean(self, score: Callable[[PooledCounts], Tensor]) -> Tensor:
        """Return the weighted mean of a score over the drives."""
        total = sum(weights * score(part) for weights, part in self.drives)
        return torch.as_tensor(total) / len(self.drives)


def observe(tally: Tally) -> Replicates:
    """Return the counts of all images, each drive once."""
    drives = [(torch.tensor(1), pool_groups(tally, {drive: 0.5})) for drive in tally.road]
    return Replicates(pool_groups(tally, dict.fromkeys(tally.road, 0.5)), drives)


def replicate(tally: Tally) -> Replicates:
    """Draw images within each drive; means over few drives get Student's t.

    Tallies of the same images get the same draws, so that differences are paired. Pooled counts
    are those of these drives.
    """
    generator = torch.Generator().manual_seed(BOOTSTRAP_SEED)
    by_drive = student_weights(len(tally.road), generator).unbind(1)
    tables = [tally.table([name]) for name in tally.road]
    weights = [bootstrap_weights(len(table.names), generator) for table in tables]
    parts = [pool_replicates(table, math.nan, w) for table, w in zip(tables, weights, strict=True)]
    whole = pool_replicates(tally.table(tally.road), math.nan, torch.cat(weights, 1))
    return Replicates(whole, list(zip(by_drive, parts, strict=True)))


def with_interval(value: Tensor, replicates: Tensor, style: str = ".3f") -> str:
    """Format a score with its 95 % interval, ".957 (.929–.971)"; "to" between signed ends."""
    limits = (-math.inf, math.inf) if "+" in style else (0.0, 1.0)
    ends = (float(value), *percentile_interval(replicates.clamp(*limits)))
    score, low, high = (f"{end:{style}}".replace("0.", ".", 1) for end in ends)
    return f"{score} ({low} to {high})" if "+" in style else f"{score} ({low}–{high})"
