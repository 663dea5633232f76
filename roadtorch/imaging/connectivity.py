"""4-connected superpixels: the largest region of each label is kept, others are merged."""

import numpy as np
import torch
from torch import Tensor


def connect(labels: Tensor, smallest: float = 1.0) -> Tensor:
    """Make the segments of labels (H, W) 4-connected, numbered 0…n-1: int64.

    Of each label the largest region is kept if it has at least ``smallest`` pixels. The pixels of
    all other regions join an adjacent segment, from the region's border inwards.
    """
    from skimage.measure import label  # slow to import

    image = labels.cpu().numpy().astype(np.int32)
    # Regions are numbered as they appear.
    region = np.asarray(label(image, background=-1, connectivity=1)) - 1
    size = np.bincount(region.reshape(-1))
    segment = np.empty(len(size), dtype=np.int32)
    segment[region] = image
    settled = _is_largest(segment, size) & (size >= smallest)
    settled[size.argmax()] = True
    # Settled regions are numbered in order of appearance; others get -1.
    numbers = np.where(settled, settled.cumsum() - 1, -1)
    return torch.from_numpy(_grow(numbers[region])).to(labels.device)


def _is_largest(group: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Mark the largest region of each group; the first one where sizes are equal."""
    rank = (size + 1) * len(size) - np.arange(len(size))
    best = np.zeros(group.max() + 1, dtype=rank.dtype)
    np.maximum.at(best, group, rank)
    return rank == best[group]


def _grow(numbers: np.ndarray) -> np.ndarray:
    """Fill pixels of -1 in a map (H, W) by their highest 4-neighbour, repeatedly and in place."""
    height, width = numbers.shape
    flat = numbers.reshape(-1)
    empty = np.flatnonzero(flat == -1)
    row, column = np.divmod(empty, width)
    # At the image border a pixel is its own neighbour; it is -1 and never the highest.
    neighbours = np.stack(
        [
            empty - width * (row > 0),
            empty - (column > 0),
            empty + (column < width - 1),
            empty + width * (row < height - 1),
        ]
    )
    while len(empty):
        highest = flat.take(neighbours).max(0)
        flat[empty] = highest
        unfilled = np.flatnonzero(highest < 0)
        empty, neighbours = empty.take(unfilled), neighbours.take(unfilled, 1)
    return numbers
