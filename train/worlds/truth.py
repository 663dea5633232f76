"""Codes of the truth, and the decision for a pixel with several sample points."""

import numpy as np

SKY, VERTICAL, HORIZONTAL, ROAD, EGO, VOID = 0, 1, 2, 3, 4, 255
"""Codes: layout without road, road, the ego car, uncertain."""

COLOURS = {SKY: (0, 0, 0), VERTICAL: (0, 0, 1), HORIZONTAL: (0, 1, 0)}
COLOURS |= {ROAD: (1, 1, 0), EGO: (1, 0, 0), VOID: (1, 1, 1)}
"""Of the codes, for the pass that renders them."""

THIN = 1 / 3
"""Fraction of a pixel from which a standing object is its truth: posts, legs and tyres are thin."""


def settle_truth(codes: np.ndarray, fine: int) -> np.ndarray:
    """Decide the truth of pixels (H, W), each with ``fine`` by ``fine`` sample points.

    A pixel is vertical from a fraction of ``THIN`` on, otherwise the most frequent code.
    """
    height, width = (side // fine for side in codes.shape)
    points = codes.reshape(height, fine, width, fine).transpose(0, 2, 1, 3)
    points = points.reshape(height, width, fine * fine)
    kinds = np.array([VOID, SKY, HORIZONTAL, ROAD, EGO, VERTICAL], np.uint8)
    counts = np.stack([(points == kind).sum(2) for kind in kinds])
    upright = counts[-1] >= THIN * fine * fine
    return np.where(upright, np.uint8(VERTICAL), kinds[counts.argmax(0)])
