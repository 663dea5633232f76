"""4-connected superpixels: the largest region of each label is kept, others are merged."""

from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor


class Runs(NamedTuple):
    """Horizontal runs of equal label in images (B, H, W), in reading order.

    start: index of a run's first pixel among all pixels. length: pixels. region: number of the
    4-connected region that the run belongs to, from 0 in order of appearance.
    """

    start: np.ndarray
    length: np.ndarray
    region: np.ndarray


def connect(labels: Tensor, smallest: float = 1.0) -> Tensor:
    """Make the segments of labels (B, H, W) 4-connected, numbered 0…n-1 in each image: int64.

    Of each label the largest region is kept if it has at least ``smallest`` pixels. The pixels of
    all other regions join an adjacent segment, from the region's border inwards.
    """
    images = labels.cpu().numpy().astype(np.int32)
    stride = int(images.max()) + 1
    images += np.arange(len(images), dtype=np.int32)[:, None, None] * stride
    start, length, region = _runs(images)
    size = np.bincount(region, length).astype(np.int64)
    label = np.empty(len(size), dtype=np.int32)
    label[region] = images.reshape(-1)[start]
    image = label // stride
    settled = _is_largest(label, size) & (size >= smallest) | _is_largest(image, size)
    # Settled regions are numbered 0…n-1 in each image in order of appearance; others get -1.
    survivors = np.nonzero(settled)[0]
    survivors = survivors[np.argsort(image[survivors], kind="stable")]
    numbers = np.full(len(image), -1, dtype=np.int64)
    owners = image[survivors]
    numbers[survivors] = np.arange(len(survivors)) - np.searchsorted(owners, owners)
    number = numbers[region]
    grown = _grow(number.repeat(length).reshape(images.shape))
    return torch.from_numpy(grown).to(labels.device)


def _runs(images: np.ndarray) -> Runs:
    """Find the runs of images (B, H, W) that have no label in common."""
    begins = np.ones(images.shape, dtype=bool)
    np.not_equal(images[..., 1:], images[..., :-1], out=begins[..., 1:])
    start = np.flatnonzero(begins)
    length = np.diff(start, append=begins.size)
    run = np.arange(len(start), dtype=np.int32).repeat(length)
    # Pairs of vertically adjacent runs, once each: pixels where either of the two begins. The
    # first row of an image shares no label with the last row of the image before it.
    rows, begins = images.reshape(-1, images.shape[2]), begins.reshape(-1, images.shape[2])
    above = np.flatnonzero((rows[1:] == rows[:-1]) & (begins[1:] | begins[:-1]))
    upper, lower = run[above], run[above + images.shape[2]]
    first = np.zeros(len(start) + 1, dtype=np.int32)
    np.cumsum(np.bincount(upper, minlength=len(start)), out=first[1:])
    touch = np.ones(len(upper), dtype=np.int8)
    touching = csr_array((touch, lower, first), shape=(len(start),) * 2)
    return Runs(start, length, connected_components(touching, directed=False)[1])


def _is_largest(group: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Mark the largest region of each group; the first one where sizes are equal."""
    rank = (size + 1) * len(size) - np.arange(len(size))
    best = np.zeros(group.max() + 1, dtype=rank.dtype)
    np.maximum.at(best, group, rank)
    return rank == best[group]


def _grow(numbers: np.ndarray) -> np.ndarray:
    """Fill pixels of -1 in maps (B, H, W) by their highest 4-neighbour, repeatedly and in place."""
    height, width = numbers.shape[1:]
    flat = numbers.reshape(-1)
    empty = np.flatnonzero(flat == -1)
    row, column = np.divmod(empty, width)
    row %= height
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
