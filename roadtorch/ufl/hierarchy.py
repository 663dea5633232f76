"""The tree of regions above rising thresholds, and the choice among its nodes (P1, section II.C).

Regions are numbered from 1 over all levels, in reading order of their first pixel; 0 is
"none". Region 1 is the whole map. A node is named after its first, largest region, so the
root is node 1. Tables of regions have a row 0 for "none".
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from pydantic import Field
from scipy.ndimage import label
from torch import Tensor

from roadtorch.base.settings import Settings

TopLevel = Literal["included", "left_out"]
Nodes = Literal["runs", "regions"]


class RegionTreeSettings(Settings):
    """Thresholds and the least size of a region."""

    levels: int = Field(default=16, ge=1, le=1024, description="L, steps of the thresholds")
    top: TopLevel = Field(
        default="included", description="the threshold 1, which only closes nodes (program)"
    )
    least: int = Field(
        default=50, ge=1, le=10**6, description="minPts, pixels of the map that a region needs"
    )
    nodes: Nodes = Field(
        default="runs",
        description="what a node is: a region and all that follow until it splits (P1), or a "
        "single region",
    )


@dataclass(frozen=True)
class Regions:
    """The 4-connected regions of every level. N regions.

    labels: int32 (levels,H,W), the region of every pixel, 0 below the threshold.
    level: int64 (N+1,), from 0; -1 for "none".
    parent: int64 (N+1,), the region one level below that holds it; 0 for region 1.
    area: int64 (N+1,), pixels; 0 for "none".
    """

    labels: Tensor
    level: Tensor
    parent: Tensor
    area: Tensor


@dataclass(frozen=True)
class Tree:
    """The reduced tree: nodes made of regions of following levels. M nodes, the root first.

    node: int64 (M,), the first region of each node, rising, so that a parent comes first.
    parent: int64 (M,), index into the nodes; -1 for the root.
    node_of: int64 (N+1,), by region the index of its node; -1 where it was too small.
    """

    regions: Regions
    node: Tensor
    parent: Tensor
    node_of: Tensor


def thresholds(levels: int, top: TopLevel) -> Tensor:
    """0, 1/L, …, (L-1)/L and, if included, 1: float64."""
    return torch.arange(levels + (top == "included"), dtype=torch.float64) / levels


def threshold_regions(mean_map: Tensor, steps: Tensor) -> Regions:
    """The regions of a map (H,W) in [0,1] at or above each of the steps (levels,).

    The first level is the whole map, whatever its values are.
    """
    values = mean_map.detach().cpu().to(torch.float64).numpy()
    labels = np.ones((len(steps), *values.shape), np.int32)
    first = [np.zeros(2, np.int64)]  # first pixels of "none" and of the whole map
    for level, step in enumerate(steps.tolist()[1:], 1):
        regions = np.empty(values.shape, np.int32)
        # 4-connected, in reading order; with an output it returns the number alone.
        count = int(label(values >= step, output=regions))  # type: ignore[arg-type]
        labels[level] = np.where(regions > 0, regions + sum(map(len, first)) - 1, 0)
        place = np.empty(count + 1, np.int64)  # written backwards: what stays is the first
        place[regions.reshape(-1)[::-1]] = np.arange(regions.size)[::-1]
        first.append(place[1:])
    counts = np.array([2, *map(len, first[1:])])
    level = np.repeat(np.arange(len(steps)), counts)
    level[0] = -1
    below = labels.reshape(len(steps), -1)[np.maximum(level - 1, 0), np.concatenate(first)]
    below[:2] = 0
    areas = np.bincount(labels.reshape(-1), minlength=int(counts.sum()))
    areas[0] = 0
    return Regions(
        torch.from_numpy(labels),
        torch.from_numpy(level),
        torch.from_numpy(below.astype(np.int64)),
        torch.from_numpy(areas),
    )


def build_tree(regions: Regions, least: int, nodes: Nodes = "runs") -> Tree:
    """Join regions of at least ``least`` pixels into nodes.

    ``runs``: of the large enough regions inside a region, an only one joins its node; two or
    more start nodes of their own. ``regions``, ours: each is a node. Then a selected region
    is the one worth most, where P1 takes the largest of a run that is worth most together.
    The root is the whole map, however small.
    """
    level, parent = regions.level.numpy(), regions.parent.numpy()
    kept = regions.area.numpy() >= least
    kept[:2] = False, True
    siblings = np.bincount(parent[kept], minlength=len(parent))
    joined = (siblings == 1) & (nodes == "runs")
    owner = np.zeros(len(parent), np.int64)
    owner[1] = 1
    for step in range(1, int(level.max()) + 1):
        mine = np.flatnonzero((level == step) & kept)
        owner[mine] = np.where(joined[parent[mine]], owner[parent[mine]], mine)
    node = np.flatnonzero(owner == np.arange(len(owner)))[1:]
    index = np.full(len(owner), -1)
    index[node] = np.arange(len(node))
    return Tree(
        regions,
        torch.from_numpy(node),
        torch.from_numpy(index[owner[parent[node]]]),
        torch.from_numpy(index[owner]),
    )


def region_sums(regions: Regions, values: Tensor) -> Tensor:
    """The sum of values (H,W) over each region, float64 (N+1,); 0 for "none"."""
    labels = regions.labels.reshape(-1).numpy()
    weights = values.cpu().to(torch.float64).reshape(1, -1).expand(len(regions.labels), -1)
    sums = np.bincount(labels, weights.reshape(-1).numpy(), len(regions.area))
    sums[0] = 0
    return torch.from_numpy(sums)


def node_stability(tree: Tree, pixels: Tensor) -> Tensor:
    """S of every node, float64 (M,): eqs. 7 and 8, over the number of pixels of the map.

    pixels: (H,W), the stability of eq. 6. The whole map at the first level is not counted,
    as in the authors' program; it would weigh on the root alone.
    """
    sums = region_sums(tree.regions, pixels)
    sums[1] = 0
    inside = tree.node_of >= 0
    total = torch.zeros(len(tree.node), dtype=torch.float64)
    total.index_add_(0, tree.node_of[inside], sums[inside])
    return total / pixels.numel()


@dataclass(frozen=True)
class NodeChoice:
    """Which nodes are road: selected bool (M,), stability S and best sums S-hat, float64 (M,)."""

    selected: Tensor
    stability: Tensor
    best: Tensor


def select_nodes(
    tree: Tree, stability: Tensor, whole: Literal["if_undivided", "never"] = "if_undivided"
) -> NodeChoice:
    """Eq. 9: the disjoint nodes with the greatest sum of stabilities, bottom-up.

    A node that is worth more than the best of what it holds takes its place. The root takes
    no part, except where it is the only node and ``whole`` allows for it.
    """
    own, parent = stability.tolist(), tree.parent.tolist()
    inside = [0.0] * len(own)  # the best sum of the children
    best, wins = [0.0] * len(own), [False] * len(own)
    for node in reversed(range(1, len(own))):
        wins[node] = own[node] > 0 and own[node] >= inside[node]
        best[node] = own[node] if wins[node] else inside[node]
        inside[parent[node]] += best[node]
    best[0] = inside[0]
    if len(own) == 1 and whole == "if_undivided":
        wins[0] = own[0] > 0
        best[0] = max(0.0, own[0])
    # Of the winners those without a winner above them; parents come before their children.
    covered = [False] * len(own)
    for node in range(1, len(own)):
        covered[node] = covered[parent[node]] or wins[parent[node]]
    topmost = [won and not hidden for won, hidden in zip(wins, covered, strict=True)]
    return NodeChoice(torch.tensor(topmost), stability, torch.tensor(best, dtype=torch.float64))


def node_area(tree: Tree, node: int) -> Tensor:
    """The first, largest region of a node (index), bool (H,W)."""
    region = int(tree.node[node])
    return tree.regions.labels[int(tree.regions.level[region])] == region


def selected_area(tree: Tree, selected: Tensor) -> Tensor:
    """The first regions of the selected nodes (M,) together, bool (H,W)."""
    return paint_nodes(tree, selected.to(torch.int64)).to(torch.bool)


def paint_nodes(tree: Tree, values: Tensor) -> Tensor:
    """Greatest value (M,) ≥ 0 over the nodes whose first region holds a pixel, else 0: (H,W)."""
    table = torch.zeros(len(tree.node_of), dtype=values.dtype)
    table[tree.node] = values
    levels = tree.regions.level[tree.node].unique()
    return table[tree.regions.labels[levels].long()].amax(0)
