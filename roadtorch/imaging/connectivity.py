"""Labels made 4-connected: of each the largest region stays, the others join what they touch."""

from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor


class Runs(NamedTuple):
    """Horizontal runs of equal label in images (B,H,W), in reading order.

    start: place of the first pixel of each among all pixels; length: pixels; region: the number
    of the 4-connected region that it is part of, from 0, as they are met.
    """

    start: np.ndarray
    length: np.ndarray
    region: np.ndarray


def connect(labels: Tensor, smallest: float = 1.0) -> Tensor:
    """Make every segment 4-connected and number the segments 0…n-1 in each image.

    labels: integers (B,H,W). Of each label the largest region stays, unless it has fewer
    than ``smallest`` pixels; the pixels of every other region join a settled segment that
    they touch, from its border inwards. Returns int64 (B,H,W).
    """
    images = labels.cpu().numpy().astype(np.int32)
    stride = int(images.max()) + 1
    images += np.arange(len(images), dtype=np.int32)[:, None, None] * stride
    start, length, region = _runs(images)
    size = np.bincount(region, length).astype(np.int64)
    label = np.empty(len(size), dtype=np.int32)
    label[region] = images.reshape(-1)[start]
    image = label // stride
    settled = _largest_of(label, size) & (size >= smallest) | _largest_of(image, size)
    # Settled regions are numbered 0…n-1 in each image, as they are met; the others are -1.
    kept = np.nonzero(settled)[0]
    kept = kept[np.argsort(image[kept], kind="stable")]
    numbers = np.full(len(image), -1, dtype=np.int64)
    numbers[kept] = np.arange(len(kept)) - np.searchsorted(image[kept], image[kept])
    number = numbers[region]
    grown = _grow(number.repeat(length).reshape(images.shape))
    return torch.from_numpy(grown).to(labels.device)


def _runs(images: np.ndarray) -> Runs:
    """The runs of images (B,H,W) whose labels differ from image to image."""
    begins = np.ones(images.shape, dtype=bool)
    np.not_equal(images[..., 1:], images[..., :-1], out=begins[..., 1:])
    start = np.flatnonzero(begins)
    length = np.diff(start, append=begins.size)
    run = np.arange(len(start), dtype=np.int32).repeat(length)
    # Where either of two runs begins that lie above one another: once for each such pair. The
    # first row of an image has no labels in common with the last one of the image before.
    rows, begins = images.reshape(-1, images.shape[2]), begins.reshape(-1, images.shape[2])
    above = np.flatnonzero((rows[1:] == rows[:-1]) & (begins[1:] | begins[:-1]))
    upper, lower = run[above], run[above + images.shape[2]]
    first = np.zeros(len(start) + 1, dtype=np.int32)
    np.cumsum(np.bincount(upper, minlength=len(start)), out=first[1:])
    touch = np.ones(len(upper), dtype=np.int8)
    touching = csr_array((touch, lower, first), shape=(len(start),) * 2)
    return Runs(start, length, connected_components(touching, directed=False)[1])


def _largest_of(group: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Whether a region is the largest of its group; the first one where sizes are equal."""
    rank = (size + 1) * len(size) - np.arange(len(size))
    best = np.zeros(group.max() + 1, dtype=rank.dtype)
    np.maximum.at(best, group, rank)
    return rank == best[group]


def _grow(numbers: np.ndarray) -> np.ndarray:
    """Fill the pixels -1 of maps int64 (B,H,W) from their 4 neighbours, in place.

    Round by round; each takes the highest number it touches, so that the result does not depend
    on an order.
    """
    height, width = numbers.shape[1:]
    flat = numbers.reshape(-1)
    empty = np.flatnonzero(flat == -1)
    row, column = np.divmod(empty, width)
    row %= height
    # Beyond the edge lies the pixel itself, which has nothing to give.
    around = np.stack(
        [
            empty - width * (row > 0),
            empty - (column > 0),
            empty + (column < width - 1),
            empty + width * (row < height - 1),
        ]
    )
    while len(empty):
        highest = flat.take(around).max(0)
        flat[empty] = highest
        left = np.flatnonzero(highest < 0)
        empty, around = empty.take(left), around.take(left, 1)
    return numbers
