"""Seeded random numbers."""

import torch
from torch import Tensor


def seeded_generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def random(*size: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    """Sample uniformly from [0, 1)."""
    return torch.rand(*size, generator=seeded_generator(seed), dtype=dtype)
