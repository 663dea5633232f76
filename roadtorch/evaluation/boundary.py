"""Boundary F: how well the boundary of the predicted road matches the true one.

F over areas hardly changes with where exactly the road ends, which matters to a vehicle. A
boundary pixel of one mask is correct when the other mask has a boundary pixel within a tolerance.
Precision is the fraction of correct pixels of the predicted boundary, recall that of the true one.
Tolerances are fractions of the image diagonal, so that they mean the same at any size.

Sources: Martin, Fowlkes, Malik, PAMI 2004 (matching boundaries within a tolerance); Csurka,
Larlus, Perronnin, BMVC 2013 (boundary F per class, 0.75 % of the diagonal, also the default of
MATLAB's bfscore); Perazzi et al., CVPR 2016 (DAVIS: 0.8 %, in whole pixels).
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.base.image_cache import cached_per_image

TIGHT_TOLERANCE = 0.00375
"""Fraction of the diagonal, 3 pixels at 640x480; shown in the tables by group and condition."""

TOLERANCES = (TIGHT_TOLERANCE, 0.0075)
"""Fractions of the diagonal, 3 and 6 pixels at 640x480: Csurka's tolerance, and half of it."""


def count_boundary(
    mask: Tensor, road: Tensor, valid: Tensor, tolerances: Sequence[float] = TOLERANCES
) -> Tensor:
    """Count the boundary pixels of a mask and of the truth; counts of several images add up.

    mask, road, valid: bool (H, W). Returns int64 (tolerances, 4): predicted boundary pixels within
    the tolerance of a true one, all predicted ones, true ones within it of a predicted one, all
    true ones.
    """
    predicted, (true, to_true) = boundary_pixels(mask, valid), true_boundary(road, valid)
    diagonal = math.hypot(*mask.shape)
    margin = math.ceil(max(tolerances) * diagonal)  # farther pixels are not within any tolerance
    left, top, width, height = cv2.boundingRect(true.view(np.uint8))
    rows = slice(max(0, top - margin), top + height + margin)
    window = rows, slice(max(0, left - margin), left + width + margin)
    distances = to_true[predicted], _distance_transform(predicted[window])[true[window]]
    # Squared distances are integers. Without rounding, OpenCV's last digit, which depends on its
    # threads, would decide about pixels exactly at the tolerance.
    forward, backward = (np.rint(np.square(part)) for part in distances)
    sums = [
        [(forward <= limit).sum(), predicted.sum(), (backward <= limit).sum(), true.sum()]
        for limit in ((tolerance * diagonal) ** 2 + 1e-6 for tolerance in tolerances)
    ]
    return torch.tensor(np.array(sums, np.int64))


def boundary_pixels(mask: Tensor, valid: Tensor) -> np.ndarray:
    """Return the valid pixels of a mask (H, W) with a valid 4-neighbour outside it; bool (H, W).

    Where the mask meets void or the image border there is no boundary: whether the road ends there
    is unknown.
    """
    outside = (~mask & valid).numpy().view(np.uint8)
    near_outside = cv2.dilate(outside, cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)))
    return near_outside.view(np.bool_) & (mask & valid).numpy()


@cached_per_image
def true_boundary(road: Tensor, valid: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Return the boundary of the truth, bool (H, W), and the distance to it; cached per image."""
    true = boundary_pixels(road, valid)
    return true, _distance_transform(true)


def _distance_transform(pixels: np.ndarray) -> np.ndarray:
    """Return each pixel's distance to the nearest True, float32 (H, W); infinite without any."""
    if not pixels.any():
        return np.full(pixels.shape, np.inf, np.float32)
    return cv2.distanceTransform((~pixels).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


def boundary_f(counts: Tensor) -> Tensor:
    """Compute F of boundary precision and recall, counts (..., 4) → float64 (...).

    NaN where neither mask has a boundary, 0 where only one has.
    """
    decided_right, decided, true_right, true = counts.to(torch.float64).unbind(-1)
    precision = decided_right / decided.clamp(min=1)
    recall = true_right / true.clamp(min=1)
    # Without a single right pixel the mean of P and R is 0, and so is F.
    f = 2 * precision * recall / (precision + recall).where(decided_right + true_right > 0, 1)
    return f.where(decided + true > 0, torch.nan)
