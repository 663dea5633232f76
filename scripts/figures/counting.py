"""Counts of detectors on a labelled set, and intervals of scores."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.data.dataset import Dataset
from roadtorch.evaluation.evaluate import tally_images
from roadtorch.evaluation.methods import Contender, collect_contenders
from roadtorch.evaluation.result import pool_groups
from roadtorch.evaluation.tally import PooledCounts, Tally, pool
from roadtorch.evaluation.uncertainty import (
    BOOTSTRAP_SEED,
    bootstrap_weights,
    percentile_interval,
    student_weights,
)

Tallies = Mapping[str, Tally]


def count_images(dataset: Dataset, contenders: Sequence[str | Contender]) -> Tallies:
    """Count every image of a set for each contender; RuntimeError for an image that fails."""
    entries = collect_contenders(dataset, contenders, {}, with_baselines=False)
    tallies, failures = tally_images(dataset, entries, jobs=1, quiet=False)
    if failures:
        raise RuntimeError(f"{failures[0].image}: {failures[0].reason}")
    return tallies


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
    parts = [pool(table, {}, w) for table, w in zip(tables, weights, strict=True)]
    whole = pool(tally.table(tally.road), {}, torch.cat(weights, 1))
    return Replicates(whole, list(zip(by_drive, parts, strict=True)))


def with_interval(value: Tensor, replicates: Tensor, style: str = ".3f") -> str:
    """Format a score with its 95 % interval, ".957 (.929–.971)"; "to" between signed ends."""
    limits = (-math.inf, math.inf) if "+" in style else (0.0, 1.0)
    ends = (float(value), *percentile_interval(replicates.clamp(*limits)))
    score, low, high = (f"{end:{style}}".replace("0.", ".", 1) for end in ends)
    return f"{score} ({low} to {high})" if "+" in style else f"{score} ({low}–{high})"
