"""Road of Xia et al.: clusters around density peaks, their regions labelled by a graph cut.

Rodriguez and Laio, "Clustering by fast search and find of density peaks", Science 344, 2014. Each
connected component of a cluster is a region, described by a bag of words: the histogram of the
nearest bases of its patches. Xia, Zhang, Lu and Qin, "Road detection via unsupervised feature
learning", IVCNZ 2015, names these parts; P1 does not give their costs, so those here are ours.
"""

import numpy as np
import torch
from pydantic import Field
from scipy.sparse import coo_array
from torch import Tensor

from roadtorch.base.settings import Settings
from roadtorch.imaging.segments import segment_histogram
from roadtorch.road.texture import similarity

CAPACITY = 1000  # integer capacity units per pixel: the maximum flow is computed in integers


class PeakSettings(Settings):
    """Settings of the clustering by density peaks."""

    clusters: int = Field(
        default=8, ge=2, le=100, description="number of clusters: the clearest density peaks"
    )
    samples: int = Field(
        default=1000,
        ge=10,
        le=10_000,
        description="evenly spread pixels among which peaks are searched",
    )
    neighbours: float = Field(
        default=0.02, gt=0, le=1, description="fraction of all pairs that counts as near"
    )


class CutSettings(Settings):
    """Settings of the graph cut."""

    border_cost: float = Field(
        default=2.0,
        ge=0,
        le=1000,
        description="cost of separating two identical regions, per pixel of their border",
    )


def density_peaks(points: Tensor, clusters: int, neighbours: float) -> Tensor:
    """Return the indices of the density peaks of points (n, d), int64 (k,), the clearest first.

    Density is a sum of Gaussians of the distances; their width is the quantile ``neighbours`` of
    all distances. Peaks maximise the product of density and distance to the nearest denser point.
    """
    distances = torch.cdist(points, points)
    width = distances.flatten().kthvalue(max(1, round(neighbours * distances.numel()))).values
    width = width.clamp_min(torch.finfo(distances.dtype).tiny)
    density = (-(distances / width).square()).exp().sum(1)
    order = density.argsort(descending=True, stable=True)
    rank = order.argsort()
    denser = rank < rank[:, None]  # row i: the points denser than i
    separation = distances.masked_fill(~denser, torch.inf).amin(1)
    separation[order[0]] = distances[order[0]].amax()
    return (density * separation).argsort(descending=True, stable=True)[:clusters]


def cluster_pixels(features: Tensor, settings: PeakSettings) -> Tensor:
    """Return the nearest peak of each pixel of features (m, H, W), int64 (H, W).

    Xia et al. follow the chain of denser neighbours through all pixels. Ours searches peaks in a
    sample: the pairwise distances of 17,825 pixels take gigabytes.
    """
    pixels = features.flatten(1).T
    sample = pixels[:: max(1, len(pixels) // settings.samples)]
    peaks = sample[density_peaks(sample, settings.clusters, settings.neighbours)]
    return torch.cdist(pixels, peaks).argmin(1).view(features.shape[1:])


def connected_regions(clusters: Tensor) -> Tensor:
    """Return the 4-connected components of clusters int64 (H, W), numbered from 0."""
    from skimage.measure import label  # slow to import

    pieces = np.asarray(label(clusters.cpu().numpy(), background=-1, connectivity=1), np.int64)
    return torch.from_numpy(pieces) - 1


def shared_borders(regions: Tensor) -> tuple[Tensor, Tensor]:
    """Return pairs of adjacent regions (p, 2), the smaller first, and border lengths in pixels."""
    across = torch.stack([regions[:, :-1], regions[:, 1:]], -1).view(-1, 2)
    down = torch.stack([regions[:-1], regions[1:]], -1).view(-1, 2)
    pairs = torch.cat([across, down])
    pairs = pairs[pairs[:, 0] != pairs[:, 1]].sort(1).values
    return pairs.unique(dim=0, return_counts=True)


def cut_road(
    regions: Tensor, words: Tensor, count: int, seed: Tensor, settings: CutSettings
) -> Tensor:
    """Return the road mask, bool (H, W): regions on the source side of the minimum cut.

    Calling a region non-road costs its area times the similarity of its bag of words to the seed's;
    calling it road, its area times the similarity to the top row's; separating two neighbours,
    ``border_cost`` times their border length times their similarity in [0, 1].

    regions: number of each pixel's region, int64 (H, W). words: nearest base of each pixel's patch,
    int64 (H, W), below ``count``. seed: seed area, bool (H, W).
    """
    bags = segment_histogram(words, regions, int(regions.max()) + 1, count)
    top = torch.zeros_like(seed)
    top[0] = True
    like_road, like_background = (
        similarity(bags, torch.bincount(words[area], minlength=count).float()) * bags.sum(1)
        for area in (seed, top)
    )
    pairs, length = shared_borders(regions)
    costs = settings.border_cost * length * similarity(bags[pairs[:, 0]], bags[pairs[:, 1]])
    return source_side(like_road, like_background, pairs, costs)[regions]


def source_side(source: Tensor, sink: Tensor, pairs: Tensor, between: Tensor) -> Tensor:
    """Return the nodes on the source side of a minimum cut, bool (n,).

    ``source`` and ``sink`` are capacities (n,) ≥ 0 of each node's edges to both, ``between``
    capacities (p,) in both directions of the edges between ``pairs`` (p, 2) of nodes.
    """
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    count, nodes = len(source), np.arange(len(source))
    first, second = pairs.numpy().T
    rows = np.concatenate([np.full(count, count), nodes, first, second])
    columns = np.concatenate([nodes, np.full(count, count + 1), second, first])
    capacity = torch.cat([source, sink, between, between]).mul(CAPACITY)
    capacity = capacity.clamp_max(2**29).round().int().numpy()  # residuals stay int32
    graph = coo_array((capacity, (rows, columns)), (count + 2, count + 2)).tocsr()
    residual = graph - maximum_flow(graph, count, count + 1).flow
    residual.data = np.maximum(residual.data, 0)
    residual.eliminate_zeros()
    reached = breadth_first_order(residual, count, return_predecessors=False)
    with_source = torch.zeros(count + 2, dtype=torch.bool)
    with_source[torch.from_numpy(reached).long()] = True
    return with_source[:count]
