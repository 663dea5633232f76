"""Border pixels and their matches the slow, obvious way: pixel by pixel, pair by pair."""

import math

import numpy as np

Place = tuple[int, int]


def border(mask: np.ndarray, valid: np.ndarray) -> list[Place]:
    """Valid pixels of the mask beside a valid pixel that is not of it."""
    height, width = mask.shape
    found = []
    for row in range(height):
        for column in range(width):
            if not (mask[row, column] and valid[row, column]):
                continue
            for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                y, x = row + down, column + right
                if 0 <= y < height and 0 <= x < width and valid[y, x] and not mask[y, x]:
                    found.append((row, column))
                    break
    return found


def matched(pixels: list[Place], others: list[Place], reach: float) -> int:
    """How many pixels have another within reach."""
    return sum(any(math.dist(pixel, other) <= reach for other in others) for pixel in pixels)


def count(mask: np.ndarray, road: np.ndarray, valid: np.ndarray, share: float) -> list[int]:
    """Decided pixels matched, decided, true ones matched, true."""
    decided, true = border(mask, valid), border(road, valid)
    reach = share * math.hypot(*mask.shape)
    return [
        matched(decided, true, reach),
        len(decided),
        matched(true, decided, reach),
        len(true),
    ]
