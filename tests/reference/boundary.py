"""Border pixels and their matches, slow and simple: pixel by pixel, pair by pair."""

import math

import numpy as np

Place = tuple[int, int]


def border(mask: np.ndarray, valid: np.ndarray) -> list[Place]:
    """Return the valid pixels of the mask next to a valid pixel outside it."""
    height, width = mask.shape
    pixels = []
    for row in range(height):
        for column in range(width):
            if not (mask[row, column] and valid[row, column]):
                continue
            for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                y, x = row + down, column + right
                if 0 <= y < height and 0 <= x < width and valid[y, x] and not mask[y, x]:
                    pixels.append((row, column))
                    break
    return pixels


def matched(pixels: list[Place], candidates: list[Place], reach: float) -> int:
    """Count the pixels that have one of the candidates within reach."""
    return sum(
        any(math.dist(pixel, candidate) <= reach for candidate in candidates) for pixel in pixels
    )


def count(mask: np.ndarray, road: np.ndarray, valid: np.ndarray, share: float) -> list[int]:
    """Count decided pixels matched, decided, true ones matched, true."""
    decided, true = border(mask, valid), border(road, valid)
    reach = share * math.hypot(*mask.shape)
    return [matched(decided, true, reach), len(decided), matched(true, decided, reach), len(true)]
