"""P1 by its definitions: one patch, one base, one pixel, one region at a time."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np


def blurred(plane: np.ndarray, sigma: float, reach: int) -> np.ndarray:
    """Eq. 1 over a square window, weights summing to 1, the border repeated; plane (H,W)."""
    offsets = range(-reach, reach + 1)
    result, total = np.zeros(plane.shape), 0.0
    rows, columns = np.arange(plane.shape[0]), np.arange(plane.shape[1])
    for i in offsets:
        for j in offsets:
            weight = np.exp(-(i**2 + j**2) / (2 * sigma**2))
            row = np.clip(rows + i, 0, plane.shape[0] - 1)
            column = np.clip(columns + j, 0, plane.shape[1] - 1)
            result += weight * plane[row[:, None], column]
            total += weight
    return result / total


def patches(image: np.ndarray, side: int) -> np.ndarray:
    """Every patch of an image (3,H,W), by rows, channel by channel: (n,d)."""
    _, height, width = image.shape
    return np.array(
        [
            image[:, row : row + side, column : column + side].reshape(-1)
            for row in range(height - side + 1)
            for column in range(width - side + 1)
        ]
    )


def lloyd(points: np.ndarray, bases: np.ndarray) -> tuple[np.ndarray, list[int]]:
    """One round of K-means by plain distances; empty clusters become zero."""
    members: list[list[np.ndarray]] = [[] for _ in bases]
    for point in points:
        members[int(np.argmin([np.sum((point - base) ** 2) for base in bases]))].append(point)
    moved = [np.mean(group, axis=0) if group else np.zeros(points.shape[1]) for group in members]
    return np.array(moved), [len(group) for group in members]


def responses(points: np.ndarray, bases: np.ndarray, by: str) -> np.ndarray:
    """Return eq. 3 (``patch``) or eq. 4 (``base``): (k, n)."""
    far = np.array([[np.linalg.norm(point - base) for point in points] for base in bases])
    usual = far.mean(axis=1, keepdims=True) if by == "base" else far.mean(axis=0)
    return np.maximum(0, usual - far)


def score(unit_map: np.ndarray) -> float:
    """Eq. 5 to the letter, for one map (H,W) in [0,1], rows counted from 1."""
    height = len(unit_map)
    return sum(
        (row - height / 2) / (height / 2) * value
        for row, values in enumerate(unit_map, 1)
        for value in values
    )


def components(mask: np.ndarray) -> Iterator[set[tuple[int, int]]]:
    """4-connected components by breadth-first search, in reading order."""
    visited = np.zeros_like(mask)
    for start in np.ndindex(*mask.shape):
        if not mask[start] or visited[start]:
            continue
        queue, regions = deque([start]), {start}
        visited[start] = True
        while queue:
            row, column = queue.popleft()
            for near in (row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1):
                inside = 0 <= near[0] < mask.shape[0] and 0 <= near[1] < mask.shape[1]
                if inside and mask[near] and not visited[near]:
                    visited[near] = True
                    regions.add(near)
                    queue.append(near)
        yield regions


@dataclass
class Node:
    """A node of the tree: its regions from the largest on, and the nodes inside it."""

    regions: list[set[tuple[int, int]]]
    children: list["Node"] = field(default_factory=list)


def grow(node: Node, level: int, values: np.ndarray, steps: list[float], least: int) -> None:
    """Follow a node through the levels, as section II.C describes."""
    if level == len(steps):
        return
    mask = np.zeros(values.shape, bool)
    for pixel in node.regions[-1]:
        mask[pixel] = values[pixel] >= steps[level]
    inside = [region for region in components(mask) if len(region) >= least]
    if len(inside) == 1:
        node.regions.append(inside[0])
        grow(node, level + 1, values, steps, least)
    for region in inside if len(inside) > 1 else []:
        child = Node([region])
        node.children.append(child)
        grow(child, level + 1, values, steps, least)


def tree(values: np.ndarray, steps: list[float], least: int) -> Node:
    """Return the tree of a map (H, W); its root begins with the whole map."""
    root = Node([set(np.ndindex(*values.shape))])
    grow(root, 1, values, steps, least)
    return root


def stability(node: Node, pixels: np.ndarray, is_root: bool = False) -> float:
    """Return eqs. 7 and 8 over the number of pixels; the root's first region does not count."""
    regions = node.regions[1:] if is_root else node.regions
    return sum(pixels[pixel] for region in regions for pixel in region) / pixels.size


def optimise(node: Node, pixels: np.ndarray) -> tuple[float, list[Node]]:
    """Return the best sum of stabilities inside a node and the nodes that give it (eq. 9)."""
    parts = [optimise(child, pixels) for child in node.children]
    inside, chosen = (
        sum(value for value, _ in parts),
        [best for _, nodes in parts for best in nodes],
    )
    value_of_node = stability(node, pixels)
    return (
        (value_of_node, [node])
        if value_of_node > 0 and value_of_node >= inside
        else (inside, chosen)
    )


def road(root: Node, pixels: np.ndarray) -> np.ndarray:
    """Return the first regions of the best nodes, bool (H, W); the root only where it is alone."""
    if root.children:
        chosen = [best for child in root.children for best in optimise(child, pixels)[1]]
    else:
        chosen = [root] if stability(root, pixels, is_root=True) > 0 else []
    mask = np.zeros(pixels.shape, bool)
    for node in chosen:
        for pixel in node.regions[0]:
            mask[pixel] = True
    return mask


def errors(maps: np.ndarray, mask: np.ndarray, fraction: float, is_centred: bool) -> np.ndarray:
    """Eq. 10 pixel by pixel, P from a singular value decomposition; maps (m,H,W)."""
    samples = maps[:, mask].T
    mean = samples.mean(axis=0) if is_centred else np.zeros(len(maps))
    _, sizes, axes = np.linalg.svd(samples - mean, full_matrices=False)
    share = np.cumsum(sizes**2) / np.sum(sizes**2)
    basis = axes[: int(np.argmax(share >= fraction)) + 1].T
    result = np.zeros(mask.shape)
    for pixel in np.ndindex(*mask.shape):
        z = maps[:, *pixel] - mean
        result[pixel] = np.linalg.norm(z - basis @ basis.T @ z)
    return result


def to_image(mask: np.ndarray) -> np.ndarray:
    """Patches of side 6 to pixels: blocks of 2×2 at offset 2, then rows and columns repeated."""
    height, width = mask.shape[0] + 5, mask.shape[1] + 5
    full = np.zeros((height, width), bool)
    for row, column in zip(*np.nonzero(mask), strict=True):
        full[row + 2 : row + 4, column + 2 : column + 4] = True
    full[:2], full[-2:] = full[2], full[-3]
    full[:, :2], full[:, -2:] = full[:, 2:3], full[:, -3:-2]
    return full
