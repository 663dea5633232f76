"""Xia et al.'s roads: clusters around peaks of density, their pieces parted by a graph cut.

Rodriguez and Laio, "Clustering by fast search and find of density peaks", Science 344, 2014.
Each connected piece of a cluster is a region; its bag of words counts the nearest bases of its
patches. Xia, Zhang, Lu and Qin, "Road detection via unsupervised feature learning", IVCNZ 2015,
names these parts; its costs are not in P1, so those here are ours.
"""

import numpy as np
import torch
from pydantic import Field
from scipy.sparse import coo_array
from torch import Tensor

from roadtorch.base.settings import Settings
from roadtorch.imaging.segments import segment_histogram
from roadtorch.road.texture import similarity

CAPACITY = 1000
"""Steps of a capacity for each pixel: the maximum flow is one of whole numbers."""


class PeakSettings(Settings):
    """How many clusters, of which samples."""

    clusters: int = Field(default=8, ge=2, le=100, description="peaks of density that are kept")
    samples: int = Field(
        default=1000, ge=10, le=10_000, description="pixels, evenly spread, among which they are"
    )
    neighbours: float = Field(
        default=0.02, gt=0, le=1, description="share of all pairs that counts as near"
    )


class CutSettings(Settings):
    """What the cut weighs."""

    border: float = Field(
        default=2.0,
        ge=0,
        le=1000,
        description="cost of parting two regions that are alike, for each pixel of their border",
    )


def density_peaks(points: Tensor, clusters: int, neighbours: float) -> Tensor:
    """Which of n points (n,d) are the peaks: int64 (k,), k ≤ clusters, the clearest first.

    Density is a sum of Gaussians of the distances, their width the quantile ``neighbours`` of
    all; a point's other figure is its distance to the nearest one that is denser. Peaks are where
    the product of both is greatest.
    """
    far = torch.cdist(points, points)
    width = far.flatten().kthvalue(max(1, round(neighbours * far.numel()))).values
    density = (-(far / width.clamp_min(torch.finfo(far.dtype).tiny)).square()).exp().sum(1)
    order = density.argsort(descending=True, stable=True)
    rank = order.argsort()
    denser = rank < rank[:, None]  # in row i the points that are denser than i
    apart = far.masked_fill(~denser, torch.inf).amin(1)
    apart[order[0]] = far[order[0]].amax()
    return (density * apart).argsort(descending=True, stable=True)[:clusters]


def cluster_pixels(features: Tensor, settings: PeakSettings) -> Tensor:
    """The cluster of every pixel, int64 (H,W): that of the nearest peak; features: (m,H,W).

    Xia et al. follow the chain of denser neighbours through all pixels; ours looks for peaks
    among a sample, for the distances of all pairs of 17,825 pixels take gigabytes.
    """
    pixels = features.flatten(1).T
    step = max(1, len(pixels) // settings.samples)
    sample = pixels[::step]
    peaks = sample[density_peaks(sample, settings.clusters, settings.neighbours)]
    return torch.cdist(pixels, peaks).argmin(1).view(features.shape[1:])


def connected_regions(clusters: Tensor) -> Tensor:
    """The 4-connected pieces of clusters int64 (H,W): int64 (H,W), numbered from 0."""
    from skimage.measure import label  # late: slow to import

    pieces = np.asarray(label(clusters.cpu().numpy(), background=-1, connectivity=1), np.int64)
    return torch.from_numpy(pieces) - 1


def shared_borders(regions: Tensor) -> tuple[Tensor, Tensor]:
    """Pairs of neighbouring regions (p,2), the smaller number first, and their border in pixels."""
    across = torch.stack([regions[:, :-1], regions[:, 1:]], -1).view(-1, 2)
    down = torch.stack([regions[:-1], regions[1:]], -1).view(-1, 2)
    pairs = torch.cat([across, down])
    pairs = pairs[pairs[:, 0] != pairs[:, 1]].sort(1).values
    return pairs.unique(dim=0, return_counts=True)


def cut_road(
    regions: Tensor, words: Tensor, count: int, seed: Tensor, settings: CutSettings
) -> Tensor:
    """Which pixels are road, bool (H,W): the regions on the road's side of the minimum cut.

    words: int64 (H,W), each below ``count``; seed: bool (H,W). It costs a region's pixels, times
    how alike its bag of words is to that of the seed, to call it no road, and as much for the
    likeness to the top row to call it road; to part two neighbours their border times their
    likeness.
    """
    bags = segment_histogram(words, regions, int(regions.max()) + 1, count)
    top = torch.zeros_like(seed)
    top[0] = True
    like_road, like_rest = (
        similarity(bags, torch.bincount(words[area], minlength=count).float()) * bags.sum(1)
        for area in (seed, top)
    )
    pairs, length = shared_borders(regions)
    parting = settings.border * length * similarity(bags[pairs[:, 0]], bags[pairs[:, 1]])
    return source_side(like_road, like_rest, pairs, parting)[regions]


def source_side(source: Tensor, sink: Tensor, pairs: Tensor, between: Tensor) -> Tensor:
    """The nodes that a minimum cut leaves with the source, bool (n,).

    source, sink: capacities (n,) ≥ 0 of each node's edges to both; between: capacities (p,) in
    both ways of the edges between pairs (p,2) of nodes.
    """
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    count = len(source)
    nodes = np.arange(count)
    here, there = pairs.numpy().T
    rows = np.concatenate([np.full(count, count), nodes, here, there])
    columns = np.concatenate([nodes, np.full(count, count + 1), there, here])
    capacity = torch.cat([source, sink, between, between]).mul(CAPACITY).round().int().numpy()
    graph = coo_array((capacity, (rows, columns)), (count + 2, count + 2)).tocsr()
    rest = graph - maximum_flow(graph, count, count + 1).flow
    rest.data = np.maximum(rest.data, 0)
    rest.eliminate_zeros()
    reached = breadth_first_order(rest, count, return_predecessors=False)
    with_source = torch.zeros(count + 2, dtype=torch.bool)
    with_source[torch.from_numpy(reached).long()] = True
    return with_source[:count]
