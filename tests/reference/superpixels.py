"""Superpixels and statistics of segments by their definitions, one pixel at a time."""

import numpy as np

from tests.reference.ufl import components


def connected(labels: np.ndarray, smallest: int) -> np.ndarray:
    """Keep the largest region of each label of a map (H, W), the first of equals, if large enough.

    The largest of all is always kept. Numbered in row-major order; round by round the remaining
    pixels take the highest number that they touch.
    """
    pieces = [region for label in np.unique(labels) for region in components(labels == label)]
    pieces.sort(key=min)  # in reading order
    settled = [max(pieces, key=len)]
    for label in np.unique(labels):
        largest = max((piece for piece in pieces if labels[min(piece)] == label), key=len)
        settled += [largest] if len(largest) >= smallest and largest not in settled else []
    numbers = np.full(labels.shape, -1)
    for number, region in enumerate(sorted(settled, key=min)):
        numbers[tuple(zip(*region, strict=True))] = number
    while (numbers < 0).any():
        beyond = np.pad(numbers, 1, constant_values=-1)
        around = beyond[:-2, 1:-1], beyond[2:, 1:-1], beyond[1:-1, :-2], beyond[1:-1, 2:]
        numbers = np.where(numbers < 0, np.max(around, 0), numbers)
    return numbers


def nine_distances(
    pixel: np.ndarray, cell: tuple[int, int], centres: np.ndarray
) -> dict[tuple[int, int], float]:
    """Return squared distances of a pixel (5,) to centres (5, rows, columns) around its cell."""
    return {
        (row, column): float(((pixel - centres[:, row, column]) ** 2).sum())
        for row in range(max(0, cell[0] - 1), min(cell[0] + 2, centres.shape[1]))
        for column in range(max(0, cell[1] - 1), min(cell[1] + 2, centres.shape[2]))
    }


def borders(labels: np.ndarray, plane: np.ndarray) -> dict[tuple[int, int], float]:
    """Return the mean of the larger value along the border of each pair of touching segments."""
    values: dict[tuple[int, int], list[float]] = {}
    for row, column in np.ndindex(*labels.shape):
        for near in ((row + 1, column), (row, column + 1)):
            if near[0] == labels.shape[0] or near[1] == labels.shape[1]:
                continue
            low, high = sorted((int(labels[row, column]), int(labels[near])))
            if low != high:
                larger = max(float(plane[row, column]), float(plane[near]))
                values.setdefault((low, high), []).append(larger)
    return {pair: float(np.mean(along)) for pair, along in values.items()}
