"""P2's road likelihood and mask, slow and simple: layout times texture (eqs. 1 to 4).

Superpixels and the normalised image are inputs; the constants that P2 does not state (levels and
their range) are those of docs/how/layout_texture.md.
"""

import cv2
import numpy as np

from tests.reference import cnn7_training, network, texture
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
    area = planes[:, *training_area(height, width)].reshape(len(PLANES), -1)
    inverse, ones = np.linalg.pinv(np.cov(area, bias=True)), np.ones(len(PLANES))
    fused = texture.fused(planes, inverse @ ones / (ones @ inverse @ ones))
    ordered = np.sort(fused.ravel())
    skipped = int(TAIL * len(ordered))
    low, high = ordered[skipped], ordered[-1 - skipped]
    return np.clip(np.floor((fused - low) / (high - low) * BINS), 0, BINS - 1).astype(int)


def training_area(height: int, width: int) -> tuple[slice, slice]:
    """Return P2's area at the bottom, 30×80 of 240×320, as rows and columns."""
    rows, columns = round(30 * height / 240), round(80 * width / 320)
    left = (width - columns) // 2
    return slice(height - rows, height), slice(left, left + columns)


def road_map(image: Array, weights: dict[str, Array], segments: Array) -> Array:
    """Return eq. 4 with a uniform prior (H, W) at every pixel of an image (3, H, W) in [0, 1]."""
    levels, result = fused_levels(image), np.empty(segments.shape)
    for segment in range(segments.max() + 1):
        inside = segments == segment
        result[inside] = texture.uniformity_of_values(levels[inside])
    pixels = np.pad((image - 0.5) * 4, ((0, 0), (16, 16), (16, 16)), "reflect")
    for row in range(len(segments)):
        patches = [
            pixels[:, row : row + 32, column : column + 32] for column in range(len(segments[0]))
        ]
        result[row] *= cnn7_training.potentials(weights, np.array(patches))[0][:, 2, 0, 0]
    return result


def decide(likelihood: Array, threshold: float) -> Array:
    """Return the mask (H, W) above λ, without areas apart from the training area (section 6.2)."""
    _, areas = cv2.connectedComponents((likelihood > threshold).astype(np.uint8), connectivity=4)
    kept = np.unique(areas[training_area(*likelihood.shape)])
    return np.isin(areas, kept[kept > 0])
