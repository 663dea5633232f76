"""Statistics of the pixels of each segment, and the borders between segments."""

import torch
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
    levels: Tensor, labels: Tensor, count: int, bins: int, weight: Tensor | None = None
) -> Tensor:
    """How often each level occurs in each segment: float32 (count, bins).

    levels: int64 (H,W) in 0…bins-1. weight: (H,W) or None; pixels with weight 0 do not count.
    """
    index = labels.reshape(-1) * bins + levels.reshape(-1)
    weights = None if weight is None else weight.reshape(-1).to(torch.float64)
    counts = torch.bincount(index, weights=weights, minlength=count * bins)
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
    keys, values = [], []
    for axis in (0, 1):
        length = labels.shape[axis] - 1
        one, two = labels.narrow(axis, 0, length), labels.narrow(axis, 1, length)
        value = torch.maximum(plane.narrow(axis, 0, length), plane.narrow(axis, 1, length))
        differ = one != two
        one, two = one[differ], two[differ]
        keys.append(torch.minimum(one, two) * count + torch.maximum(one, two))
        values.append(value[differ])
    key, place = torch.cat(keys).unique(return_inverse=True)
    size = torch.bincount(place, minlength=len(key)).to(plane)
    total = torch.bincount(place, torch.cat(values), len(key)).to(plane)
    return torch.stack([key // count, key % count]), total / size
