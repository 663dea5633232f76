"""What is measured of each superpixel, and how alike superpixels are.

The layout labeller and the fused detector both learn, in one image, what a class looks
like from the segments that are believed to belong to it. This is the part they share.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.base.image_cache import cached_per_image
from roadtorch.imaging.color import planes


def segment_mean(planes: Sequence[Tensor] | Tensor, labels: Tensor, size: Tensor) -> Tensor:
    """Mean of each of C planes (H,W) over each of n segments of labels (H,W): (C,n); 0 if empty.

    size: int64 (n,), their pixels, by ``segment_size``. Added up in float64: a large segment would
    lose what a pixel adds to it.
    """
    segment = labels.reshape(-1).cpu().numpy()
    sums = [
        np.bincount(segment, plane.reshape(-1).cpu().numpy(), minlength=len(size))
        for plane in planes
    ]
    total = torch.from_numpy(np.stack(sums)).to(planes[0])
    return total / size.to(total.dtype).clamp_min_(1)


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


LIGHTNESS_SHARE = 0.3
"""Weight of lightness against a and b in the contrast of a border: the edge of a shadow changes
mostly lightness, that of a verge colour too."""

UNLIKE = 160.0
"""Squared distance of segments as unlike as can be: exp(-80) is no denormal number, which
processors take long over."""

RAREST = 1e-8
"""The least density: a segment like no other keeps its prior."""


class Bandwidths(NamedTuple):
    """How far two segments may be apart and still be alike: widths of Gaussian kernels.

    lightness: in L, from 0 to 1. chroma: in a and b, in units of L. gradient: in the mean gradient,
    L per pixel. contrast: in the deviation of L inside. row, column: in the image's sides.
    """

    lightness: float
    chroma: float
    gradient: float
    contrast: float
    row: float
    column: float


@dataclass(frozen=True)
class Segments:
    """The superpixels of one image. n segments; places are shares of height and width."""

    labels: Tensor
    """int64 (H,W), 0…n-1."""
    pixels: Tensor
    """int64 (n,): how many each has."""
    color: Tensor
    """(3,n): mean L, a, b, each divided by 100."""
    gradient: Tensor
    """(n,): mean length of the gradient of L."""
    contrast: Tensor
    """(n,): standard deviation of L."""
    row: Tensor
    """(n,): centroid, 0 at the top edge, 1 at the bottom edge."""
    column: Tensor
    """(n,): centroid, 0 at the left edge, 1 at the right edge."""
    size: Tensor
    """(n,): share of the image's pixels; sums to 1."""
    pairs: Tensor
    """int64 (2,E): segments that share a border, each pair once."""
    contrast_between: Tensor
    """(E,): mean of ``border_contrast`` along the border of each pair."""


@cached_per_image
def measure_segments(image: Tensor, labels: Tensor) -> Segments:
    """Measure the segments ``labels`` (H,W) of an image (3,H,W) in [0,1]."""
    height, width = labels.shape
    count = int(labels.max()) + 1
    lab = planes(image, ("L", "a", "b"))
    rows = ((torch.arange(height).to(image) + 0.5) / height)[:, None].expand(height, width)
    columns = ((torch.arange(width).to(image) + 0.5) / width).expand(height, width)
    maps = [*lab, lab[0].square(), gradient_length(lab[0]), rows, columns]
    pixels = segment_size(labels, count)
    mean = segment_mean(maps, labels, pixels)
    pairs, between = borders(labels, border_contrast(lab))
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
    """How much a pixel looks like a border, (H,W): gradient of Lab/100 (3,H,W), less noise.

    The mean of 3×3 pixels goes first, against sensor noise; lightness counts by
    ``LIGHTNESS_SHARE``.
    """
    before = (lab * lab.new_tensor([LIGHTNESS_SHARE, 1, 1])[:, None, None]).cpu().numpy()
    after = np.empty_like(before)
    for plane, target in zip(before, after, strict=True):
        cv2.blur(plane, (3, 3), dst=target, borderType=cv2.BORDER_REPLICATE)
    return _difference_squares(torch.from_numpy(after).to(lab.device)).sum(0).sqrt_().div_(2)


def gradient_length(planes: Tensor) -> Tensor:
    """Length of the gradient of planes (…,H,W): central differences, 0 past the edge."""
    return _difference_squares(planes).sqrt_().div_(2)


def _difference_squares(planes: Tensor) -> Tensor:
    """Of the pixels beside, and of those above and below: the sum of both differences squared."""
    squares = torch.zeros_like(planes)
    across = planes[..., 2:] - planes[..., :-2]
    down = planes[..., 2:, :] - planes[..., :-2, :]
    squares[..., 1:-1].addcmul_(across, across)
    squares[..., 1:-1, :].addcmul_(down, down)
    return squares


def likeness(segments: Segments, bandwidths: Bandwidths) -> Tensor:
    """(n,n) in [0,1]: product of Gaussian kernels over appearance and place, 1 for itself."""
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
    # xᵀy - |x|²/2 - |y|²/2 is -|x-y|²/2: one product, and no root that is squared again.
    exponent = torch.addmm(-half[:, None] - half, points, points.T)
    return exponent.clamp_(-UNLIKE / 2, 0).exp_()


def class_log_density(alike: Tensor, posterior: Tensor, size: Tensor) -> Tensor:
    """log p(segment | class), (n,C), by kernel density over the segments themselves.

    alike: (n,n) from ``likeness``; posterior: (n,C), what each segment is believed to be;
    size: (n,). A class with next to no support keeps a finite density.
    """
    support = posterior.T * size
    # alike is symmetric; from the left, the product is three times as fast.
    density = (support @ alike).div_(support.sum(1, keepdim=True).clamp_min_(1e-3))
    return density.clamp_min_(RAREST).log_().T
