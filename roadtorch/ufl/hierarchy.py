"""Regions above rising thresholds as a tree, and the choice of its nodes (P1, section II.C).

Regions are numbered from 1 over all levels, in row-major order of their first pixel; 0 is "none".
Region 1 is the whole map. A node is named after its first, largest region: the root is node 1.
Tables of regions have a row 0 for "none".
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
    """Settings of the thresholds and regions."""

    levels: int = Field(default=16, ge=1, le=1024, description="L, the number of threshold steps")
    top: TopLevel = Field(
        default="included", description="include threshold 1, which only ends nodes (program)"
    )
    min_area: int = Field(
        default=50, ge=1, le=10**6, description="minPts, least area of a region, pixels of the map"
    )
    nodes: Nodes = Field(
        default="runs",
        description="node of the tree: a run of regions up to the next split (P1), or one region",
    )


@dataclass(frozen=True, eq=False)
class Regions:
    """4-connected regions of all levels; N regions.

    Attributes:
        labels: int32 (levels, H, W), region of each pixel; 0 below the threshold.
        level: int64 (N+1,), level from 0; -1 for "none".
        parent: int64 (N+1,), enclosing region one level below; 0 for region 1.
        area: int64 (N+1,), pixels; 0 for "none".
    """

    labels: Tensor
    level: Tensor
    parent: Tensor
    area: Tensor


@dataclass(frozen=True, eq=False)
class RegionTree:
    """Reduced tree: nodes made of regions of consecutive levels; M nodes, the root first.

    Attributes:
        node: int64 (M,), first region of each node, rising, so that parents come first.
        parent: int64 (M,), index of the parent node; -1 for the root.
        node_of: int64 (N+1,), index of each region's node; -1 where it was too small.
    """

    regions: Regions
    node: Tensor
    parent: Tensor
    node_of: Tensor


def region_thresholds(levels: int, top: TopLevel) -> Tensor:
    """Return 0, 1/L, …, (L-1)/L and, if included, 1: float64."""
    return torch.arange(levels + (top == "included"), dtype=torch.float64) / levels


def threshold_regions(mean_map: Tensor, steps: Tensor) -> Regions:
    """Return the connected regions of a map (H, W) in [0, 1] at or above steps (levels,).

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
        pixel = np.empty(count + 1, np.int64)  # written backwards: the first remains
        pixel[regions.reshape(-1)[::-1]] = np.arange(regions.size)[::-1]
        first.append(pixel[1:])
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


def build_tree(regions: Regions, min_area: int, nodes: Nodes = "runs") -> RegionTree:
    """Join regions of at least ``min_area`` pixels into nodes; the root is the whole map.

    ``runs``: a region with a single large enough child shares its node; several children start
    nodes of their own. ``regions``, ours: each region is a node. Then the best single region is
    selected, where P1 selects the largest of the best run.
    """
    level, parent = regions.level.numpy(), regions.parent.numpy()
    large = regions.area.numpy() >= min_area
    large[:2] = False, True
    siblings = np.bincount(parent[large], minlength=len(parent))
    joined = (siblings == 1) & (nodes == "runs")
    owner = np.zeros(len(parent), np.int64)
    owner[1] = 1
    for step in range(1, int(level.max()) + 1):
        numbers = np.flatnonzero((level == step) & large)
        parents = parent[numbers]
        owner[numbers] = np.where(joined[parents], owner[parents], numbers)
    node = np.flatnonzero(owner == np.arange(len(owner)))[1:]
    index = np.full(len(owner), -1)
    index[node] = np.arange(len(node))
    return RegionTree(
        regions,
        torch.from_numpy(node),
        torch.from_numpy(index[owner[parent[node]]]),
        torch.from_numpy(index[owner]),
    )


def region_sums(regions: Regions, values: Tensor) -> Tensor:
    """Return the sum of values (H, W) over each region, float64 (N+1,); 0 for region 0."""
    labels = regions.labels.reshape(-1).numpy()
    weights = values.cpu().to(torch.float64).reshape(1, -1).expand(len(regions.labels), -1)
    sums = np.bincount(labels, weights.reshape(-1).numpy(), len(regions.area))
    sums[0] = 0
    return torch.from_numpy(sums)


def node_stability(tree: RegionTree, pixels: Tensor) -> Tensor:
    """Return S of each node (eqs. 7 and 8) over the map's area, float64 (M,).

    ``pixels`` has the stability (H, W) of eq. 6. The first level is not counted, as in the authors'
    program; it would affect the root alone.
    """
    sums = region_sums(tree.regions, pixels)
    sums[1] = 0
    inside = tree.node_of >= 0
    total = torch.zeros(len(tree.node), dtype=torch.float64)
    total.index_add_(0, tree.node_of[inside], sums[inside])
    return total / pixels.numel()


@dataclass(frozen=True, eq=False)
class NodeChoice:
    """Selected nodes, bool (M,); stability S and best sums S-hat, float64 (M,)."""

    selected: Tensor
    stability: Tensor
    best: Tensor


def select_nodes(
    tree: RegionTree, stability: Tensor, whole: Literal["if_undivided", "never"] = "if_undivided"
) -> NodeChoice:
    """Select the disjoint nodes with the greatest sum of stabilities, bottom-up (eq. 9).

    A node replaces its descendants where its stability is positive and at least their best sum. The
    root is selected only where it is the only node and ``whole`` permits it.
    """
    values, parent = stability.tolist(), tree.parent.tolist()
    inside = [0.0] * len(values)  # the best sum of the children
    best, wins = [0.0] * len(values), [False] * len(values)
    for node in reversed(range(1, len(values))):
        wins[node] = values[node] > 0 and values[node] >= inside[node]
        best[node] = values[node] if wins[node] else inside[node]
        inside[parent[node]] += best[node]
    best[0] = inside[0]
    if len(values) == 1 and whole == "if_undivided":
        wins[0] = values[0] > 0
        best[0] = max(0.0, values[0])
    # Selected: winners without a winning ancestor; parents come before their children.
    covered = [False] * len(values)
    for node in range(1, len(values)):
        covered[node] = covered[parent[node]] or wins[parent[node]]
    topmost = [won and not hidden for won, hidden in zip(wins, covered, strict=True)]
    return NodeChoice(torch.tensor(topmost), stability, torch.tensor(best, dtype=torch.float64))


def node_area(tree: RegionTree, node: int) -> Tensor:
    """Return the first, largest region of a node (index), bool (H, W)."""
    region = int(tree.node[node])
    return tree.regions.labels[int(tree.regions.level[region])] == region


def selected_area(tree: RegionTree, selected: Tensor) -> Tensor:
    """Return the union of the selected nodes' (M,) first regions, bool (H, W)."""
    return paint_nodes(tree, selected.to(torch.int64)).to(torch.bool)


def paint_nodes(tree: RegionTree, values: Tensor) -> Tensor:
    """Return the greatest value (M,) ≥ 0 of the nodes whose first region has a pixel, (H, W)."""
    table = torch.zeros(len(tree.node_of), dtype=values.dtype)
    table[tree.node] = values
    levels = tree.regions.level[tree.node].unique()
    return table[tree.regions.labels[levels].long()].amax(0)
