"""Boundary F: how well the border of the decided road lies on the true one.

F of areas hardly notices where exactly the road ends; a vehicle does. A border pixel of one
mask is right when the other mask has a border pixel within a tolerance, so with the shares
of right pixels as precision (of the decided border) and recall (of the true border) F is
theirs. Tolerances are shares of the image's diagonal, to mean the same at any size.

Sources: Martin, Fowlkes, Malik, PAMI 2004 (matching borders within a tolerance); Csurka,
Larlus, Perronnin, BMVC 2013 (F of borders per class, 0.75 % of the diagonal, also the
default of MATLAB's bfscore); Perazzi et al., CVPR 2016 (DAVIS: 0.8 %, in whole pixels).
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.base.image_cache import cached_per_image

THREE_PIXELS = 0.00375
"""At 640x480: the one that tables of cameras show."""

TOLERANCES = (THREE_PIXELS, 0.0075)
"""3 and 6 pixels at 640x480: Csurka's, and half of it."""


def count_boundary(
    mask: Tensor, road: Tensor, valid: Tensor, tolerances: Sequence[float] = TOLERANCES
) -> Tensor:
    """Border pixels of one mask and of the truth, int64 (tolerances,4); they add up.

    mask, road, valid: bool (H,W). Columns: decided border pixels with a true one within the
    tolerance, all decided ones, true ones with a decided one within it, all true ones.
    """
    decided, (true, to_true) = border(mask, valid).numpy(), true_border(road, valid)
    diagonal = math.hypot(*mask.shape)
    near = _around(true, math.ceil(max(tolerances) * diagonal))
    off = to_true[decided], _distance_to(decided[near])[true[near]]
    # Squares are whole numbers. OpenCV's last digit, which depends on its threads, and ours
    # would otherwise decide whether what is exactly as far as the tolerance is within it.
    decided_off, true_off = (np.rint(np.square(distances)) for distances in off)
    rows = [
        [(decided_off <= reach).sum(), decided.sum(), (true_off <= reach).sum(), true.sum()]
        for reach in ((share * diagonal) ** 2 + 1e-6 for share in tolerances)
    ]
    return torch.tensor(np.array(rows, np.int64))


def border(mask: Tensor, valid: Tensor) -> Tensor:
    """Valid pixels of a mask (H,W) with a valid 4-neighbour outside it; bool (H,W).

    Where the mask meets void or the image's frame there is no border: nobody knows
    whether it ends there.
    """
    inside, outside = mask & valid, ~mask & valid
    beside = torch.zeros_like(mask)
    beside[1:] |= outside[:-1]
    beside[:-1] |= outside[1:]
    beside[:, 1:] |= outside[:, :-1]
    beside[:, :-1] |= outside[:, 1:]
    return beside & inside


@cached_per_image
def true_border(road: Tensor, valid: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """The border of the truth, bool (H,W), and the distance to it: once for all detectors."""
    true = border(road, valid).numpy()
    return true, _distance_to(true)


def _around(pixels: np.ndarray, margin: int) -> tuple[slice, slice]:
    """Rows and columns that hold all True pixels (H,W) and what is within a margin of them.

    What lies farther off is near none of them, and need not be looked at.
    """
    spans = []
    for axis in (1, 0):
        places = np.flatnonzero(pixels.any(axis))
        first, last = (places[0], places[-1]) if len(places) else (0, -1)
        spans.append(slice(max(0, first - margin), last + margin + 1))
    return spans[0], spans[1]


def _distance_to(pixels: np.ndarray) -> np.ndarray:
    """Distance of every place to the nearest True, float32 (H,W); infinite without any."""
    if not pixels.any():
        return np.full(pixels.shape, np.inf, np.float32)
    away = (~pixels).view(np.uint8)
    return cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


def boundary_f(counts: Tensor) -> Tensor:
    """F of border precision and recall, counts (...,4) → float64 (...).

    NaN where neither mask has a border, 0 where only one has.
    """
    decided_right, decided, true_right, true = counts.to(torch.float64).unbind(-1)
    precision = decided_right / decided.clamp(min=1)
    recall = true_right / true.clamp(min=1)
    # Without a single right pixel the mean of P and R is 0, and so is F.
    f = 2 * precision * recall / (precision + recall).where(decided_right + true_right > 0, 1)
    return f.where(decided + true > 0, torch.nan)
