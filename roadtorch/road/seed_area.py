"""The seed area: where road is assumed, to learn its look from, and what touches it."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from pydantic import Field
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from roadtorch.base.settings import Settings
from roadtorch.imaging.resize import at_image_size, resized, side, size_of, whole
from roadtorch.imaging.segments import Segments

FRAME = (240, 320)  # height and width in pixels of the frame in which a seed area is described

NEARNESS = 4.0
"""Log odds that a place at the bottom of the image has before one at the top, as a seed."""

CELL = 12
"""Pixels of a side of the cells of which a seed area is made: a superpixel's."""

UPPER_HALF = 100.0  # log odds that keep the upper half out, unless there is nothing else
STRIP = 256  # rows in which regions are looked up at a time; ours: a megabyte or so of a photograph


class SeedArea(Settings):
    """The rectangle at the middle of the bottom edge that is taken to be road.

    A detector that looks for the road itself takes an area of its size from where road most
    likely is.
    """

    height: float = Field(
        default=30, ge=1, le=FRAME[0], description="rows, of a frame of 240; scaled with the image"
    )
    width: float = Field(
        default=80, ge=1, le=FRAME[1], description="columns, of a frame of 320; scaled likewise"
    )

    @property
    def share(self) -> float:
        """Of the image's pixels, from 0 to 1."""
        return self.height * self.width / (FRAME[0] * FRAME[1])


def seed_area(
    height: int, width: int, seed: SeedArea | None = None, least: int = 1
) -> tuple[slice, slice]:
    """Rows and columns of the seed area in an image of height × width pixels.

    At the middle of the bottom edge, of at least ``least`` pixels on each side where the
    image has them, and always inside. P2 (section 4, "the central-bottom part of the
    image"); without ``seed`` the default size.
    """
    seed = SeedArea() if seed is None else seed
    rows = min(height, max(least, round(seed.height * height / FRAME[0])))
    columns = min(width, max(least, round(seed.width * width / FRAME[1])))
    left = (width - columns) // 2
    return slice(height - rows, height), slice(left, left + columns)


def seed_rectangle(shape: Sequence[int], seed: SeedArea | None = None) -> Tensor:
    """The same for maps of a shape (…,H,W), as a map bool (H,W)."""
    area = torch.zeros(shape[-2], shape[-1], dtype=torch.bool)
    area[seed_area(shape[-2], shape[-1], seed)] = True
    return area


def likely_seed(evidence: Tensor, row: Tensor, size: Tensor, share: float) -> Tensor:
    """Which of n segments are the seed area: bool (…,n), those where road most likely is.

    evidence: log odds of road (…,n); row: centroids (n,) from 0 at the top to 1; size: shares of
    the image (n,). From the lower half, the best come first until they fill ``share`` of the
    image; one at least, several pieces if need be. What is near is seen best, and counts by
    ``NEARNESS`` more. Ours: the bottom of an image may be a bonnet, grass or a car ahead.
    """
    score = evidence + NEARNESS * row - UPPER_HALF * (row < 0.5)
    # ONNX has no sort of that name, but one that is stable.
    order = (
        score.sort(descending=True).indices
        if torch.compiler.is_exporting()
        else score.argsort(descending=True, stable=True)
    )
    sizes = size.expand_as(score).gather(-1, order)
    inside = sizes.cumsum(-1) - sizes < share
    return torch.zeros_like(inside).scatter(-1, order, inside)


def likely_seed_area(evidence: Tensor, share: float) -> Tensor:
    """The same of a map of log odds (…,H,W), cell by cell: bool (…,H,W)."""
    full = size_of(evidence)
    rows, columns = (whole((side(length) / CELL).ceil(), 1) for length in full)
    cells = resized(evidence, (rows, columns))
    row = ((torch.arange(rows, device=cells.device) + 0.5) / rows)[:, None].expand(rows, columns)
    size = torch.full_like(row, 1 / (rows * columns))
    chosen = likely_seed(cells.flatten(-2), row.flatten(), size.flatten(), share)
    return at_image_size(chosen.unflatten(-1, (rows, columns)), full)


def remove_isolated(mask: Tensor, seed: Tensor) -> Tensor:
    """Keep the 4-connected regions of a mask (H,W) that touch the seed area bool (H,W).

    Where none does, the mask comes back unchanged: then it says nothing about which
    region is the road. P2, section 6.2 (isolated areas are discarded). Strip by strip: NumPy
    makes 8 bytes of every number of a region that it looks up.
    """
    pixels = mask.cpu().contiguous().numpy()  # torch takes twenty times as long for ``any``
    rows = np.flatnonzero(pixels.any(1))
    if not len(rows):
        return mask
    filled = slice(int(rows[0]), int(rows[-1]) + 1)  # above is sky: what it costs is left out
    pixels = pixels[filled].view(np.uint8)
    count, numbers = cv2.connectedComponents(pixels, connectivity=4)
    regions, within = np.asarray(numbers, dtype=np.int32), seed[filled].cpu().numpy()
    kept = np.zeros(count, dtype=bool)
    strips = [slice(at, at + STRIP) for at in range(0, len(regions), STRIP)]
    for strip in strips:
        kept[regions[strip][within[strip]]] = True
    kept[0] = False  # the background
    if not kept.any() or kept[1:].all():
        return mask
    left = torch.zeros_like(mask, device="cpu")
    for strip in strips:
        left[filled][strip] = torch.from_numpy(kept.take(regions[strip]))
    return left.to(mask.device)


def seed_segments(labels: Tensor, seed: Tensor) -> Tensor:
    """Numbers of the segments of labels (H,W) in the seed area bool (H,W): int64 (k,), k ≥ 1.

    Those that have half of their pixels in it, and always the one that fills most of it.
    """
    count = int(labels.max()) + 1
    inside = torch.bincount(labels[seed], minlength=count)
    size = torch.bincount(labels.reshape(-1), minlength=count)
    return ((2 * inside >= size.clamp_min(1)) | (inside == inside.max())).nonzero()[:, 0]


# --- how far a segment is from it -----------------------------------------------------


FAINTEST = 0.0034
"""Added to the contrast of a faint border (Lab/100): in a clean image less is no edge either."""


def seed_distance(segments: Segments, sources: Tensor) -> Tensor:
    """Distance (n,) of each segment from the sources, numbers (k,) of segments, along the image.

    The least sum of the contrasts of the borders crossed on the way: a kerb or a painted line
    must be crossed somewhere even where both sides have the same colour. The unit is a faint
    border of this image (the lower quartile), so that grain does not count. Ours, after
    the geodesic distances of interactive segmentation.
    """
    steps = segments.contrast_between
    if len(steps):
        steps = steps / (lower_quartile(steps) + FAINTEST)
    return distances(segments.pairs, steps, sources, len(segments.size))


def distance_likelihood(distance: Tensor, reach: float) -> Tensor:
    """Likelihood of road at a distance ≥ 0 from the seed area: 0.73 there, 0.5 at ``reach``."""
    return (1 - distance / reach).sigmoid()


def distances(pairs: Tensor, steps: Tensor, sources: Tensor, count: int) -> Tensor:
    """Least sum of steps on a way from any source to each of ``count`` nodes: (count,).

    pairs: int64 (2,E), each edge once; steps: (E,), ≥ 0. Dijkstra's algorithm; nodes out of
    reach are infinitely far.
    """
    first, second = pairs.cpu().numpy()
    # SciPy takes a stored 0 for a missing edge.
    cost = steps.cpu().numpy().astype(np.float64) + np.finfo(np.float32).tiny
    graph = coo_array((cost, (first, second)), shape=(count, count)).tocsr()
    least = dijkstra(graph, directed=False, indices=sources.cpu().numpy(), min_only=True)
    return torch.from_numpy(least).to(steps)


def lower_quartile(values: Tensor) -> float:
    """What a quarter of values (n,), n ≥ 1, lie below; between two of them on a straight line.

    Sorted by NumPy it takes a tenth of the time of ``torch.quantile``, and of NumPy's.
    """
    ordered = np.sort(values.detach().cpu().numpy())
    place = (len(ordered) - 1) / 4
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return float(ordered[low] + (place - low) * (ordered[high] - ordered[low]))
