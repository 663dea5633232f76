"""P2's road likelihood of single pixels, slow and simple: layout times texture (eqs. 1 to 4).

Superpixels and the normalised image are inputs; the constants that P2 does not state (levels and
their range) are those of docs/how/layout_texture.md.
"""

import numpy as np

from tests.reference import network, texture
from tests.reference.color import planes_of_pixel

Array = np.ndarray
PLANES = ("R", "G", "B", "nr", "ng", "O1", "O2", "S", "V")
BINS, TAIL = 64, 0.005


def ground(pixels: Array, weights: dict[str, Array], row: int, column: int) -> float:
    """Return the potential of the horizontal class: CNN-7 on the patch around one pixel."""
    patch = network.patch_around(pixels, row, column, 32)
    return float(network.potentials(patch, weights, 1, "mean", "sigmoid")[2])


def fused_levels(image: Array) -> Array:
    """Return the fused plane (H, W) of an image (3, H, W) in levels from 0 to 63 (eqs. 2 and 3)."""
    _, height, width = image.shape
    planes = np.empty((len(PLANES), height, width))
    for row, column in np.ndindex(height, width):
        values = planes_of_pixel(*image[:, row, column])
        planes[:, row, column] = [values[name] for name in PLANES]
    rows, columns = round(30 * height / 240), round(80 * width / 320)  # 30×80 of 240×320
    left = (width - columns) // 2
    area = planes[:, height - rows :, left : left + columns].reshape(len(PLANES), -1)
    inverse, ones = np.linalg.pinv(np.cov(area, bias=True)), np.ones(len(PLANES))
    fused = texture.fused(planes, inverse @ ones / (ones @ inverse @ ones))
    ordered = np.sort(fused.ravel())
    skipped = int(TAIL * len(ordered))
    low, high = ordered[skipped], ordered[-1 - skipped]
    return np.clip(np.floor((fused - low) / (high - low) * BINS), 0, BINS - 1).astype(int)


def road(
    image: Array, pixels: Array, weights: dict[str, Array], segments: Array, places: Array
) -> list[float]:
    """Return eq. 4 with a uniform prior at places (n, 2): ground potential times U of the segment.

    ``image`` is (3, H, W) in [0, 1], ``pixels`` the same, normalised; ``segments`` are int (H, W).
    """
    levels = fused_levels(image)
    return [
        ground(pixels, weights, row, column)
        * texture.uniformity_of_values(levels[segments == segments[row, column]])
        for row, column in places.tolist()
    ]
