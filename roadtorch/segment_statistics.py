"""Statistics of the pixels of each segment, and the borders between segments."""

import numpy as np
import torch
from scipy.sparse import coo_array
from torch import Tensor


def segment_sum(values: Tensor, labels: Tensor, count: int) -> Tensor:
    """Sum of values (C,H,W) over each of ``count`` segments of labels (H,W): (C,count).

    Added up in float64: a large segment would lose what a pixel adds to it.
    """
    index = labels.reshape(-1)
    flat = values.reshape(values.shape[0], -1).to(torch.float64)
    sums = [torch.bincount(index, weights=channel, minlength=count) for channel in flat]
    return torch.stack(sums).to(values.dtype)


def segment_mean(values: Tensor, labels: Tensor, count: int) -> Tensor:
    """Mean of values (C,H,W) over each of ``count`` segments of labels (H,W): (C,count)."""
    size = torch.bincount(labels.reshape(-1), minlength=count).to(values.dtype)
    return segment_sum(values, labels, count) / size.clamp_min(1)


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
    counts = torch.bincount(index, minlength=count * bins)[: count * bins]
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
    count = int(labels.max()) + 1
    firsts, seconds, values = [], [], []
    for axis in (0, 1):
        length = labels.shape[axis] - 1
        one, two = labels.narrow(axis, 0, length), labels.narrow(axis, 1, length)
        place = (one != two).reshape(-1).nonzero()[:, 0]
        one, two = one.reshape(-1)[place], two.reshape(-1)[place]
        value = torch.maximum(plane.narrow(axis, 0, length), plane.narrow(axis, 1, length))
        firsts.append(torch.minimum(one, two))
        seconds.append(torch.maximum(one, two))
        values.append(value.reshape(-1)[place])
    # A sparse matrix adds up what falls on one place, faster than sorting does; the sum of the
    # values is the real part, how many there are the imaginary one.
    at = torch.cat(firsts).cpu().numpy(), torch.cat(seconds).cpu().numpy()
    each = torch.cat(values).cpu().numpy() + 1j
    found = coo_array((each, at), shape=(count, count)).tocsr().tocoo()
    pairs = torch.from_numpy(np.stack([found.row, found.col]).astype(np.int64))
    sums = np.asarray(found.data, dtype=np.complex128)
    return pairs.to(labels.device), torch.from_numpy(sums.real / sums.imag).to(plane)
