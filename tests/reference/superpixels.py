"""Superpixels and statistics of segments by their definitions, one pixel at a time."""

import numpy as np


def regions(labels: np.ndarray) -> list[set[tuple[int, int]]]:
    """The 4-connected regions of equal label of a map (H,W), by flood fill, in reading order."""
    seen = np.zeros(labels.shape, dtype=bool)
    found = []
    for start in np.ndindex(*labels.shape):
        if seen[start]:
            continue
        seen[start] = True
        region, waiting = {start}, [start]
        while waiting:
            row, column = waiting.pop()
            for near in (
                (row - 1, column),
                (row + 1, column),
                (row, column - 1),
                (row, column + 1),
            ):
                inside = 0 <= near[0] < labels.shape[0] and 0 <= near[1] < labels.shape[1]
                if inside and not seen[near] and labels[near] == labels[start]:
                    seen[near] = True
                    region.add(near)
                    waiting.append(near)
        found.append(region)
    return found


def nine_distances(
    pixel: np.ndarray, cell: tuple[int, int], centres: np.ndarray
) -> dict[tuple[int, int], float]:
    """Squared distance of a pixel (5,) to each centre (5,rows,columns) around its cell."""
    result = {}
    for row in (cell[0] - 1, cell[0], cell[0] + 1):
        for column in (cell[1] - 1, cell[1], cell[1] + 1):
            if 0 <= row < centres.shape[1] and 0 <= column < centres.shape[2]:
                result[row, column] = float(((pixel - centres[:, row, column]) ** 2).sum())
    return result


def segment_values(values: np.ndarray, labels: np.ndarray, count: int) -> list[list[np.ndarray]]:
    """For each channel of values (C,H,W) and each segment, the values of its pixels."""
    return [[channel[labels == number] for number in range(count)] for channel in values]


def histogram(levels: np.ndarray, labels: np.ndarray, count: int, bins: int) -> np.ndarray:
    """(count, bins): how often each level occurs in each segment."""
    counts = np.zeros((count, bins))
    for level, label in zip(levels.ravel(), labels.ravel(), strict=True):
        counts[label, level] += 1
    return counts


def borders(labels: np.ndarray, plane: np.ndarray) -> dict[tuple[int, int], float]:
    """For each pair of touching segments, the mean along the border of the larger value."""
    height, width = labels.shape
    values: dict[tuple[int, int], list[float]] = {}
    for row in range(height):
        for column in range(width):
            for near in ((row + 1, column), (row, column + 1)):
                if near[0] == height or near[1] == width or labels[near] == labels[row, column]:
                    continue
                one, two = sorted((int(labels[row, column]), int(labels[near])))
                larger = max(float(plane[row, column]), float(plane[near]))
                values.setdefault((one, two), []).append(larger)
    return {pair: float(np.mean(found)) for pair, found in values.items()}
