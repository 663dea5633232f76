"""Statistics of the pixels of each segment, and the borders between segments."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor


def segment_sum(planes: Sequence[Tensor] | Tensor, labels: Tensor, count: int) -> Tensor:
    """Sum of each of C planes (H,W) over each of ``count`` segments of labels (H,W): (C,count).

    Added up in float64: a large segment would lose what a pixel adds to it.
    """
    segment = labels.reshape(-1).cpu().numpy()
    sums = [
        np.bincount(segment, plane.reshape(-1).cpu().numpy(), minlength=count) for plane in planes
    ]
    return torch.from_numpy(np.stack(sums)).to(planes[0])


def segment_mean(planes: Sequence[Tensor] | Tensor, labels: Tensor, size: Tensor) -> Tensor:
    """Mean of each of C planes (H,W) over each of n segments of labels (H,W): (C,n); 0 if empty.

    size: int64 (n,), their pixels, by ``segment_size``.
    """
    sums = segment_sum(planes, labels, len(size))
    return sums / size.to(sums.dtype).clamp_min_(1)


def segment_size(labels: Tensor, count: int) -> Tensor:
    """Pixels of each of ``count`` segments of labels (H,W): int64 (count,)."""
    size = np.bincount(labels.reshape(-1).cpu().numpy(), minlength=count)
    return torch.from_numpy(size).to(labels.device)


def segment_median(values: Tensor, labels: Tensor, count: int) -> Tensor:
    """Lower median of values (C,H,W) over each of ``count`` segments: (C,count); 0 if empty."""
    index = labels.reshape(-1)
    size = torch.bincount(index, minlength=count)
    middle = (size.cumsum(0) - size + (size - 1).clamp_min(0) // 2).clamp_max(index.numel() - 1)
    medians = []
    for channel in values.reshape(values.shape[0], -1):
        order = channel.argsort(stable=True)
        by_segment = order[index[order].argsort(stable=True)]
        medians.append(channel[by_segment[middle]])
    return torch.stack(medians) * (size > 0)


def segment_histogram(
    levels: Tensor, labels: Tensor, count: int, bins: int, usable: Tensor | None = None
) -> Tensor:
    """How often each level occurs in each segment: float32 (count, bins).

    levels: int64 (H,W) in 0…bins-1. usable: bool (H,W), the pixels that count; None for all.
    """
    index = (labels * bins).add_(levels).reshape(-1)
    if usable is not None:
        index = index.where(usable.reshape(-1), count * bins)  # counted behind all others
    counts = segment_size(index, count * bins)[: count * bins]
    return counts.reshape(count, bins).to(torch.float32)


def paint(values: Tensor, labels: Tensor) -> Tensor:
    """Give each pixel the value of its segment: (…,n) and labels (H,W) → (…,H,W)."""
    return values.index_select(-1, labels.reshape(-1)).reshape(*values.shape[:-1], *labels.shape)


def borders(labels: Tensor, plane: Tensor) -> tuple[Tensor, Tensor]:
    """Pairs of segments that share a border, and the mean of a plane along it.

    labels: int64 (H,W), n segments; plane: (H,W). Returns int64 (2,E), each pair once and the
    smaller number first, and (E,): the mean over neighbouring pixels on both sides of the
    border of the larger of their two values.
    """
    segment, values = (maps.reshape(-1).cpu().numpy() for maps in (labels, plane))
    count, width = int(segment.max()) + 1, labels.shape[1]
    beside = np.flatnonzero(segment[1:] != segment[:-1])
    beside = beside[beside % width != width - 1]  # the next row's first is not beside the last
    below = np.flatnonzero(segment[width:] != segment[:-width])
    here, there = np.concatenate([beside, below]), np.concatenate([beside + 1, below + width])
    one, two = segment.take(here), segment.take(there)
    value = np.maximum(values.take(here), values.take(there))
    # Both numbers in one, so that sorting brings together what belongs to one pair.
    pair = np.minimum(one, two) * count + np.maximum(one, two)
    order = pair.argsort()
    pair, value = pair[order], value[order].astype(np.float64)
    start = np.flatnonzero(np.diff(pair, prepend=-1))
    mean = np.add.reduceat(value, start) / np.diff(start, append=len(pair)) if len(pair) else value
    pairs = np.stack(np.divmod(pair[start], count))
    return torch.from_numpy(pairs).to(labels.device), torch.from_numpy(mean).to(plane)
