"""Seed area: where road is assumed, to learn its appearance from; regions connected to it."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from pydantic import Field
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from roadtorch.base.settings import Settings
from roadtorch.imaging.levels import descending_order
from roadtorch.imaging.resize import (
    resize_maps,
    resize_to_image,
    round_to_pixels,
    side_length,
    spatial_size,
)
from roadtorch.imaging.segments import Segments

REFERENCE_SIZE = (240, 320)  # height and width, pixels, of the image for which sizes are given

BOTTOM_BONUS = 4.0
"""Log odds by which the bottom of the image is preferred over its top when choosing a seed."""

SEED_CELL = 12
"""Side in pixels of the cells that make up a seed area."""

UPPER_HALF_PENALTY = 100.0  # log odds; excludes the upper half unless there is nothing else
STRIP_ROWS = 256  # rows of the region map processed at a time; ours: about a megabyte


class SeedArea(Settings):
    """Rectangle at the middle of the bottom edge that is assumed to be road.

    Detectors that choose their seed area themselves choose as many pixels where road is likeliest.
    """

    height: float = Field(
        default=30,
        ge=1,
        le=REFERENCE_SIZE[0],
        description="height of the area assumed to be road, in 240ths of the image's height; only "
        "height × width counts where the detector chooses the area",
    )
    width: float = Field(
        default=80,
        ge=1,
        le=REFERENCE_SIZE[1],
        description="its width, in 320ths of the image's width",
    )

    @property
    def fraction(self) -> float:
        """Fraction of the image's pixels."""
        return self.height * self.width / (REFERENCE_SIZE[0] * REFERENCE_SIZE[1])


def seed_area(
    height: int, width: int, seed: SeedArea | None = None, least: int = 1
) -> tuple[slice, slice]:
    """Return rows and columns of the seed area, with sides of ``least`` pixels or more if possible.

    P2, section 4, "the central-bottom part of the image".
    """
    seed = SeedArea() if seed is None else seed
    rows = min(height, max(least, round(seed.height * height / REFERENCE_SIZE[0])))
    columns = min(width, max(least, round(seed.width * width / REFERENCE_SIZE[1])))
    left = (width - columns) // 2
    return slice(height - rows, height), slice(left, left + columns)


def seed_rectangle(shape: Sequence[int], seed: SeedArea | None = None) -> Tensor:
    """Return the rectangle of the seed area as a mask, bool (H, W), for a shape (…, H, W)."""
    area = torch.zeros(shape[-2], shape[-1], dtype=torch.bool)
    area[seed_area(shape[-2], shape[-1], seed)] = True
    return area


def find_seed_segments(evidence: Tensor, row: Tensor, size: Tensor, fraction: float) -> Tensor:
    """Select the likeliest road segments of the lower half, bool (…, n), that fill a fraction.

    At least one; they need not be adjacent, and lower ones, which show the road best, are preferred
    by ``BOTTOM_BONUS``. Ours: the bottom of an image may be a bonnet, grass or a car ahead.
    evidence: log odds of road, (…, n). row: centroids, 0 at the top to 1, (n,). size: fractions of
    the image, (n,). fraction: of the image, to be filled.
    """
    score = evidence + BOTTOM_BONUS * row - UPPER_HALF_PENALTY * (row < 0.5)
    order = descending_order(score)
    sizes = size.expand_as(score).gather(-1, order)
    inside = sizes.cumsum(-1) - sizes < fraction
    return torch.zeros_like(inside).scatter(-1, order, inside)


def find_seed_area(evidence: Tensor, fraction: float) -> Tensor:
    """Select a fraction of the image as seed area, bool (…, H, W), by log odds (…, H, W)."""
    full = spatial_size(evidence)
    rows, columns = (round_to_pixels((side_length(n) / SEED_CELL).ceil(), 1) for n in full)
    cells = resize_maps(evidence, (rows, columns))
    row = ((torch.arange(rows, device=cells.device) + 0.5) / rows)[:, None].expand(rows, columns)
    size = torch.full_like(row, 1 / (rows * columns))
    chosen = find_seed_segments(cells.flatten(-2), row.flatten(), size.flatten(), fraction)
    return resize_to_image(chosen.unflatten(-1, (rows, columns)), full)


def remove_isolated(mask: Tensor, seed: Tensor) -> Tensor:
    """Keep the 4-connected regions of a mask (H, W) that touch the seed area, bool (H, W).

    Returns the mask itself if no region or every region does. P2, section 6.2. Works in strips, as
    NumPy's index takes 8 bytes a pixel.
    """
    pixels = mask.cpu().contiguous().numpy()  # torch takes twenty times as long for ``any``
    rows = np.flatnonzero(pixels.any(1))
    if not len(rows):
        return mask
    filled = slice(int(rows[0]), int(rows[-1]) + 1)  # skips the sky, to save time
    pixels = pixels[filled].view(np.uint8)
    count, numbers = cv2.connectedComponents(pixels, connectivity=4)
    if count == 2:  # one region
        return mask
    regions, within = np.asarray(numbers, dtype=np.int32), seed[filled].cpu().numpy()
    keep = np.zeros(count, dtype=bool)
    strips = [slice(row, row + STRIP_ROWS) for row in range(0, len(regions), STRIP_ROWS)]
    for strip in strips:
        keep[regions[strip][within[strip]]] = True
    keep[0] = False  # the background
    if not keep.any() or keep[1:].all():
        return mask
    connected = torch.zeros_like(mask, device="cpu")
    for strip in strips:
        connected[filled][strip] = torch.from_numpy(keep.take(regions[strip]))
    return connected.to(mask.device)


def segments_inside(labels: Tensor, seed: Tensor) -> Tensor:
    """Return the labels, int64 (k,), of the segments (H, W) in the seed area, bool (H, W); k ≥ 1.

    Segments with half of their pixels in it, and always the one that fills most of it.
    """
    count = int(labels.max()) + 1
    inside = torch.bincount(labels[seed], minlength=count)
    size = torch.bincount(labels.reshape(-1), minlength=count)
    return ((2 * inside >= size.clamp_min(1)) | (inside == inside.max())).nonzero()[:, 0]


# --- distance from it -----------------------------------------------------------------


MIN_CONTRAST = 0.0034
"""Added to the contrast (Lab/100) of a faint border, which is nearly 0 in clean images."""

HALF_DISTANCE = 1.7
"""Number of faint borders from the seed area at which the likelihood of road is 0.5."""


def seed_distance(segments: Segments, sources: Tensor) -> Tensor:
    """Compute the geodesic distance (n,) of each segment from the source segments (k,).

    The least sum of border contrasts on the way there, in units of their lower quartile in this
    image, so that noise does not count: a kerb must be crossed somewhere even where both sides
    have the same colour. Ours, after the geodesic distances of interactive segmentation.
    """
    steps = segments.contrast_between
    if len(steps):
        steps = steps / (lower_quartile(steps) + MIN_CONTRAST)
    return shortest_paths(segments.pairs, steps, sources, len(segments.size))


def distance_likelihood(distance: Tensor) -> Tensor:
    """Return the road likelihood by distance from the seed area: 0.73 at 0, 0.5 at the half."""
    return (1 - distance / HALF_DISTANCE).sigmoid()


def shortest_paths(pairs: Tensor, steps: Tensor, sources: Tensor, count: int) -> Tensor:
    """Compute the length of the shortest path from any source to each node, (count,); Dijkstra.

    pairs: nodes of each edge, int64 (2, E). steps: lengths ≥ 0, (E,). Infinite where there is none.
    """
    first, second = pairs.cpu().numpy()
    # SciPy takes a stored 0 for a missing edge.
    cost = steps.cpu().numpy().astype(np.float64) + np.finfo(np.float32).tiny
    graph = coo_array((cost, (first, second)), shape=(count, count)).tocsr()
    least = dijkstra(graph, directed=False, indices=sources.cpu().numpy(), min_only=True)
    return torch.from_numpy(least).to(steps)


def lower_quartile(values: Tensor) -> float:
    """Return the lower quartile of values (n,), n ≥ 1, ten times as fast as ``torch.quantile``."""
    ordered = np.sort(values.detach().cpu().numpy())
    position = (len(ordered) - 1) / 4
    low = int(position)
    high = min(low + 1, len(ordered) - 1)
    return float(ordered[low] + (position - low) * (ordered[high] - ordered[low]))
