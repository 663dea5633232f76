"""Statistics of superpixels, and kernel densities of classes over them.

The layout labeller and naive Bayes fusion learn the appearance of classes in an image with them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.base.image_cache import cached_per_image
from roadtorch.imaging.color import color_planes


def segment_mean(planes: Sequence[Tensor] | Tensor, labels: Tensor, size: Tensor) -> Tensor:
    """Compute the mean of C planes over each of n segments: (C, n), 0 for an empty segment.

    planes: C of shape (H, W). labels: int64 (H, W). size: int64 (n,), of ``segment_size``. Sums
    are in float64, as float32 loses small summands.
    """
    segment = labels.reshape(-1).cpu().numpy()
    flat = [plane.reshape(-1).cpu().numpy() for plane in planes]
    sums = [np.bincount(segment, values, minlength=len(size)) for values in flat]
    total = torch.from_numpy(np.stack(sums)).to(planes[0])
    return total / size.to(total.dtype).clamp_min_(1)


def segment_size(labels: Tensor, count: int) -> Tensor:
    """Count the pixels of each of ``count`` segments of labels (H, W): int64 (count,)."""
    size = np.bincount(labels.reshape(-1).cpu().numpy(), minlength=count)
    return torch.from_numpy(size).to(labels.device)


def segment_median(values: Tensor, labels: Tensor, count: int) -> Tensor:
    """Compute lower medians of values (C, H, W) over segments: (C, count), 0 for an empty one."""
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
    """Count how often each level occurs in each segment: float32 (count, bins).

    levels: int64 (H, W) in 0…bins-1. usable: bool (H, W), the pixels that count; None for all.
    """
    index = (labels * bins).add_(levels).reshape(-1)
    if usable is not None:
        index = index.where(usable.reshape(-1), count * bins)  # counted behind all others
    counts = segment_size(index, count * bins)[: count * bins]
    return counts.reshape(count, bins).to(torch.float32)


def paint_segments(values: Tensor, labels: Tensor) -> Tensor:
    """Expand values (…, n) of segments to the pixels of labels (H, W): (…, H, W)."""
    return values.index_select(-1, labels.reshape(-1)).reshape(*values.shape[:-1], *labels.shape)


def segment_borders(labels: Tensor, plane: Tensor) -> tuple[Tensor, Tensor]:
    """Find the pairs of adjacent segments and the mean of a plane along each border.

    labels: int64 (H, W). plane: (H, W). Returns each pair once, the smaller number first, int64
    (2, E), and the mean over pairs of pixels across the border of the larger value, (E,).
    """
    segment, values = (maps.reshape(-1).cpu().numpy() for maps in (labels, plane))
    count, width = int(segment.max()) + 1, labels.shape[1]
    right = np.flatnonzero(segment[1:] != segment[:-1])
    right = right[right % width != width - 1]  # a row's last pixel and the next row's first
    below = np.flatnonzero(segment[width:] != segment[:-width])
    first, second = np.concatenate([right, below]), np.concatenate([right + 1, below + width])
    value = np.maximum(values.take(first), values.take(second))
    first, second = segment.take(first), segment.take(second)
    # Both numbers in one, so that sorting groups the pixels of a pair.
    pair = np.minimum(first, second) * count + np.maximum(first, second)
    order = pair.argsort()
    pair, value = pair[order], value[order].astype(np.float64)
    start = np.flatnonzero(np.diff(pair, prepend=-1))
    mean = np.add.reduceat(value, start) / np.diff(start, append=len(pair)) if len(pair) else value
    pairs = np.stack(np.divmod(pair[start], count))
    return torch.from_numpy(pairs).to(labels.device), torch.from_numpy(mean).to(plane)


LIGHTNESS_WEIGHT = 0.3
"""Weight of lightness relative to a and b in border contrast, as shadows hardly change a and b."""

MAX_SQUARED_DISTANCE = 160.0
"""Bound on the squared distance of segments: exp(-80) is not yet a slow denormal number."""

MIN_DENSITY = 1e-8
"""Lower bound of a density: a segment that resembles no other keeps its prior."""


class Bandwidths(NamedTuple):
    """Standard deviations of the Gaussian kernels that compare two segments.

    lightness: of L, 0 to 1. chroma: of a and b over 100. gradient: of the mean gradient of L per
    pixel. contrast: of the standard deviation of L. row, column: fractions of the image's sides.
    """

    lightness: float
    chroma: float
    gradient: float
    contrast: float
    row: float
    column: float


@dataclass(frozen=True, eq=False)
class Segments:
    """Superpixels of one image, n of them; positions are fractions of height and width."""

    labels: Tensor
    """int64 (H, W), 0…n-1."""
    pixels: Tensor
    """int64 (n,): pixels of each."""
    color: Tensor
    """(3, n): mean L, a, b, each divided by 100."""
    gradient: Tensor
    """(n,): mean gradient magnitude of L."""
    contrast: Tensor
    """(n,): standard deviation of L."""
    row: Tensor
    """(n,): centroid, 0 at the top edge, 1 at the bottom edge."""
    column: Tensor
    """(n,): centroid, 0 at the left edge, 1 at the right edge."""
    size: Tensor
    """(n,): fraction of the image's pixels; sums to 1."""
    pairs: Tensor
    """int64 (2, E): adjacent segments, each pair once."""
    contrast_between: Tensor
    """(E,): mean of ``border_contrast`` along the border of each pair."""


@cached_per_image
def measure_segments(image: Tensor, labels: Tensor) -> Segments:
    """Measure the segments ``labels`` (H, W) of an image (3, H, W) in [0, 1]."""
    height, width = labels.shape
    count = int(labels.max()) + 1
    lab = color_planes(image, ("L", "a", "b"))
    rows = ((torch.arange(height).to(image) + 0.5) / height)[:, None].expand(height, width)
    columns = ((torch.arange(width).to(image) + 0.5) / width).expand(height, width)
    maps = [*lab, lab[0].square(), gradient_magnitude(lab[0]), rows, columns]
    pixels = segment_size(labels, count)
    mean = segment_mean(maps, labels, pixels)
    pairs, between = segment_borders(labels, border_contrast(lab))
    return Segments(
        labels,
        pixels,
        color=mean[:3],
        gradient=mean[4],
        contrast=(mean[3] - mean[0].square()).clamp_min(0).sqrt(),
        row=mean[5],
        column=mean[6],
        size=pixels.to(image) / labels.numel(),
        pairs=pairs,
        contrast_between=between,
    )


def border_contrast(lab: Tensor) -> Tensor:
    """Compute border strength (H, W): the gradient magnitude of Lab/100 (3, H, W) after smoothing.

    A 3×3 mean goes first, against sensor noise; lightness is weighted by ``LIGHTNESS_WEIGHT``.
    """
    weighted = (lab * lab.new_tensor([LIGHTNESS_WEIGHT, 1, 1])[:, None, None]).cpu().numpy()
    smooth = np.empty_like(weighted)
    for plane, target in zip(weighted, smooth, strict=True):
        cv2.blur(plane, (3, 3), dst=target, borderType=cv2.BORDER_REPLICATE)
    return _difference_squares(torch.from_numpy(smooth).to(lab.device)).sum(0).sqrt_().div_(2)


def gradient_magnitude(planes: Tensor) -> Tensor:
    """Compute the gradient magnitude of planes (…, H, W): central differences, 0 at the edge."""
    return _difference_squares(planes).sqrt_().div_(2)


def _difference_squares(planes: Tensor) -> Tensor:
    """Sum the squared central differences across and down."""
    squares = torch.zeros_like(planes)
    across = planes[..., 2:] - planes[..., :-2]
    down = planes[..., 2:, :] - planes[..., :-2, :]
    squares[..., 1:-1].addcmul_(across, across)
    squares[..., 1:-1, :].addcmul_(down, down)
    return squares


def segment_affinity(segments: Segments, bandwidths: Bandwidths) -> Tensor:
    """Compute affinities (n, n) in [0, 1]: Gaussian kernels of appearance and position."""
    scaled = [
        segments.color[0] / bandwidths.lightness,
        segments.color[1] / bandwidths.chroma,
        segments.color[2] / bandwidths.chroma,
        segments.gradient / bandwidths.gradient,
        segments.contrast / bandwidths.contrast,
        segments.row / bandwidths.row,
        segments.column / bandwidths.column,
    ]
    points = torch.stack(scaled, 1)
    half = points.square().sum(1) / 2
    # xᵀy - |x|²/2 - |y|²/2 = -|x-y|²/2: one matrix product.
    exponent = torch.addmm(-half[:, None] - half, points, points.T)
    return exponent.clamp_(-MAX_SQUARED_DISTANCE / 2, 0).exp_()


def class_log_density(affinity: Tensor, posterior: Tensor, size: Tensor) -> Tensor:
    """Estimate log p(segment | class), (n, C), by kernel density; finite even without support.

    affinity: (n, n) of ``segment_affinity``. posterior: class probabilities, (n, C). size: (n,).
    """
    support = posterior.T * size
    # affinity is symmetric; multiplied from the left, the product is three times as fast.
    density = (support @ affinity).div_(support.sum(1, keepdim=True).clamp_min_(1e-3))
    return density.clamp_min_(MIN_DENSITY).log_().T
