"""Regions of an image parted into road and the rest by a graph cut, for Xia et al.'s roads.

Each connected piece of a cluster is a region; its bag of words counts the nearest bases of its
patches. Xia, Zhang, Lu and Qin, "Road detection via unsupervised feature learning", IVCNZ 2015,
names these parts; its costs are not in P1, so those here are ours.
"""

import cv2
import numpy as np
import torch
from pydantic import Field
from scipy.sparse import coo_array
from torch import Tensor

from roadtorch.road.lbp import similarity
from roadtorch.settings import Settings

CAPACITY = 1000
"""Steps of a capacity for each pixel: the maximum flow is one of whole numbers."""


class CutSettings(Settings):
    """What the cut weighs."""

    border: float = Field(
        default=2.0,
        ge=0,
        le=1000,
        description="cost of parting two regions that are alike, for each pixel of their border",
    )


def connected_regions(clusters: Tensor) -> Tensor:
    """The 4-connected pieces of clusters int64 (H,W): int64 (H,W), numbered from 0."""
    found = np.zeros(clusters.shape, np.int64)
    count = 0
    for cluster in clusters.unique().tolist():
        mask = np.ascontiguousarray((clusters == cluster).cpu().numpy(), np.uint8)
        pieces, labels = cv2.connectedComponents(mask, connectivity=4)
        found += np.where(mask > 0, np.asarray(labels) - 1 + count, 0)
        count += pieces - 1
    return torch.from_numpy(found)


def bags_of_words(regions: Tensor, words: Tensor, count: int) -> Tensor:
    """How often each of ``count`` words occurs in each region, float32 (n,count).

    regions, words: int64 (H,W).
    """
    number = int(regions.max()) + 1
    flat = (regions * count + words).reshape(-1)
    return torch.bincount(flat, minlength=number * count).view(number, count).float()


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
    bags = bags_of_words(regions, words, count)
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
    one, two = pairs.numpy().T
    rows = np.concatenate([np.full(count, count), nodes, one, two])
    columns = np.concatenate([nodes, np.full(count, count + 1), two, one])
    capacity = torch.cat([source, sink, between, between]).mul(CAPACITY).round().int().numpy()
    graph = coo_array((capacity, (rows, columns)), (count + 2, count + 2)).tocsr()
    rest = graph - maximum_flow(graph, count, count + 1).flow
    rest.data = np.maximum(rest.data, 0)
    rest.eliminate_zeros()
    reached = breadth_first_order(rest, count, return_predecessors=False)
    found = torch.zeros(count + 2, dtype=torch.bool)
    found[torch.from_numpy(reached).long()] = True
    return found[:count]
