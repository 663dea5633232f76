"""Randomness that can be found again: a generator for each place in a run."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch

PATCH_ORDER, SITES, JITTER, PICTURE_ORDER, VARIATION = range(5)
"""What is drawn: the first number of its places, so that each has its own generators."""


def generator_at(seed: int, *place: int) -> torch.Generator:
    """A generator that belongs to this seed and place (round, epoch, chunk, …) alone.

    Nothing is carried from one place to the next, so a run that goes on in the middle draws
    what the uninterrupted one would have drawn.
    """
    state = np.random.SeedSequence([seed, *place]).generate_state(1, np.uint64)[0]
    return torch.Generator().manual_seed(int(state >> np.uint64(1)))


@contextmanager
def seeded(seed: int, *place: int) -> Iterator[None]:
    """Within the block, torch's own randomness is that of this seed and place."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(generator_at(seed, *place).initial_seed())
        yield


def uniform(generator: torch.Generator, count: int, low: float, high: float) -> torch.Tensor:
    """``count`` numbers between low and high, (count,)."""
    return low + (high - low) * torch.rand(count, generator=generator)
