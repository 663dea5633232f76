"""Where the values of one picture fall apart in two (Otsu), and log odds centred there."""

import math

import numpy as np
import torch
from torch import Tensor

BINS = 128
"""Of the histogram: the threshold is known to a part in 128 of the range."""


def otsu_threshold(values: Tensor) -> Tensor:
    """The value, a scalar, that parts values (…) into two classes that differ most.

    It maximises the variance between the classes, w₀ w₁ (μ₀ - μ₁)²; the middle of the range
    where all values are equal, and none (NaN or infinite) where one is not finite. Otsu, "A
    Threshold Selection Method from Gray-Level Histograms", IEEE Trans. SMC 9(1), 1979, eq. 18.
    """
    known = values.detach().reshape(-1).cpu().numpy()
    low, high = known.min(), known.max()
    if not 0 < high - low < math.inf:
        return values.new_tensor(float(low))
    place = ((known - low) / (high - low) * BINS).astype(np.int64)
    counts = np.bincount(place.clip(max=BINS - 1), minlength=BINS)
    edges = np.linspace(low, high, BINS + 1, dtype=np.float64)
    share = counts / len(known)
    mean = (share * (edges[:-1] + edges[1:]) / 2).cumsum()
    below = share.cumsum()
    between = (mean[-1] * below - mean) ** 2 / np.maximum(below * (1 - below), 1e-12)
    best = between >= between.max() * (1 - 1e-9)
    first = int(best.argmax())
    gap = np.minimum.accumulate(best[first:])  # is parted in its middle
    return values.new_tensor(edges[first + 1 :][gap].mean())


def centred_odds(odds: Tensor, centre: float, own: float) -> Tensor:
    """Log odds (…) of one picture less those that part road from background.

    These are between ``centre``, the same for all pictures, and the picture's own (Otsu), by
    the share ``own``. The best threshold differs from camera to camera and needs no label to
    be seen; but Otsu's alone takes too much for a narrow road, so it is not trusted whole. Ours.
    """
    if not own:
        return odds - centre
    return odds - torch.lerp(odds.new_tensor(centre), otsu_threshold(odds), own)
