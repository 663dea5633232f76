"""Comparisons, order statistics and Otsu's threshold.

NumPy compares five to ten times as fast as torch, and OpenCV selects three times as fast.
"""

import math

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.base.twins import has_twin


@has_twin
def is_at_least(values: Tensor, level: float) -> Tensor:
    """Return where values (…) are ``level`` or more, bool (…)."""
    return torch.from_numpy(values.detach().cpu().numpy() >= level).to(values.device)


@has_twin
def is_above(values: Tensor, level: float) -> Tensor:
    """Return where values (…) exceed ``level``, bool (…)."""
    return torch.from_numpy(values.detach().cpu().numpy() > level).to(values.device)


@has_twin
def select(mask: Tensor, first: Tensor, second: Tensor) -> Tensor:
    """Return the first map (H, W) where a bool mask holds, else the second, which may change."""
    arrays = [map.cpu().numpy() for map in (first, mask.byte(), second)]
    return torch.from_numpy(cv2.copyTo(*arrays)).to(second.device)


@has_twin
def descending_order(values: Tensor) -> Tensor:
    """Return the indices (…, n) that sort values (…, n), largest first; equal ones keep theirs."""
    return values.argsort(descending=True, stable=True)


def order_statistic(values: Tensor, k: int) -> float:
    """Return the ``k``-th smallest of values (n,), counted from 0; ValueError unless n > k."""
    return float(np.partition(values.detach().cpu().numpy(), k)[k])


OTSU_BINS = 128  # histogram bins: the threshold is exact to 1/128 of the range


def otsu_threshold(values: Tensor) -> Tensor:
    """Compute the threshold of values (…) that maximises the variance between classes, a scalar.

    The value itself if all are equal, NaN or infinite if a value is not finite. Otsu, "A Threshold
    Selection Method from Gray-Level Histograms", IEEE Trans. SMC 9(1), 1979, eq. 18.
    """
    array = values.detach().reshape(-1).cpu().numpy()
    low, high = array.min(), array.max()
    if not 0 < high - low < math.inf:
        return values.new_tensor(float(low))
    index = ((array - low) / (high - low) * OTSU_BINS).astype(np.int64)
    counts = np.bincount(index.clip(max=OTSU_BINS - 1), minlength=OTSU_BINS)
    edges = np.linspace(low, high, OTSU_BINS + 1, dtype=np.float64)
    frequency = counts / len(array)
    mean = (frequency * (edges[:-1] + edges[1:]) / 2).cumsum()
    below = frequency.cumsum()
    between = (mean[-1] * below - mean) ** 2 / np.maximum(below * (1 - below), 1e-12)
    best = between >= between.max() * (1 - 1e-9)
    first = int(best.argmax())
    gap = np.minimum.accumulate(best[first:])  # empty bins: the threshold is in their middle
    return values.new_tensor(edges[first + 1 :][gap].mean())
