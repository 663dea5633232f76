"""P1, Fig. 4: the tree of regions drawn, and the two iterations over it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from torch import Tensor

from roadtorch.ufl.hierarchy import Tree, build_tree, paint_nodes, threshold_regions, thresholds
from roadtorch.ufl.maps import mean_map
from roadtorch.ufl.road import Round, find_road
from scripts.figures_p1_overlay import agreement
from scripts.figures_p1_pictures import example, learned, panels, program_cues, put, save

SELECTED, GOOD, BAD = "#d55e00", "#0072b2", "#999999"
"""Selected nodes; those of positive stability that are not; the others."""

LEVELS = (2, 5, 8, 11)
"""Thresholds, in sixteenths, whose regions Fig. 4a shows."""


@dataclass(frozen=True)
class Place:
    """Where a node is drawn: its place across, and its first and last level."""

    across: float
    first: int
    last: int


def tree_places(tree: Tree) -> list[Place]:
    """A place for every node: leaves side by side in the order of the tree, parents above them.

    Siblings stay together, and a parent stands over the middle of its children.
    """
    children: dict[int, list[int]] = {}
    for node, parent in enumerate(tree.parent.tolist()):
        children.setdefault(parent, []).append(node)
    across = [0.0] * len(tree.parent)
    leaves = 0
    waiting = [(0, False)]
    while waiting:
        node, done = waiting.pop()
        own = children.get(node, [])
        if done:
            across[node] = sum(across[child] for child in own) / len(own)
        elif own:
            waiting += [(node, True), *((child, False) for child in reversed(own))]
        else:
            across[node], leaves = float(leaves), leaves + 1
    spans = [tree.regions.level[tree.node_of == node] for node in range(len(tree.parent))]
    return [Place(x, int(s.min()), int(s.max())) for x, s in zip(across, spans, strict=True)]


def draw_tree(panel: Axes, tree: Tree, last: Round) -> None:
    """The nodes as bars from their first level down to their last, joined to their parents."""
    places, parents = tree_places(tree), tree.parent.tolist()
    chosen, worth = last.choice.selected.tolist(), last.choice.stability.tolist()
    for node, place in enumerate(places):
        colour = SELECTED if chosen[node] else GOOD if worth[node] > 0 else BAD
        area = int(tree.regions.area[tree.node[node]]) / tree.regions.labels[0].numel()
        panel.plot([place.across] * 2, [place.first - 0.3, place.last + 0.3], color=colour,
                   linewidth=1 + 12 * area**0.5, solid_capstyle="butt")  # fmt: skip
        if node:
            above = places[parents[node]]
            line = [above.across, above.across, place.across, place.across]
            rise = [above.last + 0.3, above.last + 0.5, above.last + 0.5, place.first - 0.3]
            panel.plot(line, rise, color="black", linewidth=0.6)
    panel.set(xticks=[], ylabel="threshold, sixteenths", title="nodes; orange: selected")
    panel.invert_yaxis()


def grown(image: Tensor) -> tuple[Tree, Tensor, list[Round]]:
    """The tree of the authors' program on an image (3,H,W), the mean map, the iterations."""
    found, settings = learned(image)
    mean = mean_map(found.maps.maps, settings.maps.scale)
    regions = threshold_regions(mean, thresholds(settings.tree.levels, settings.tree.top))
    tree = build_tree(regions, settings.tree.least, settings.tree.nodes)
    return tree, mean, find_road(found.maps.maps, mean, tree, settings.road)


def kept_regions(tree: Tree, level: int) -> Tensor:
    """The regions of one level that belong to nodes, by node from 1, 0 elsewhere: (H,W)."""
    return (tree.node_of + 1)[tree.regions.labels[level].long()]


def figure4a(data: Path, out: Path) -> None:
    """The tree: regions above rising thresholds, and the nodes that they are joined to."""
    tree, mean, rounds = grown(example(data)[0])
    figure, axes = panels(2 * (1 + len(LEVELS)), 1 + len(LEVELS), 2.8)
    for panel in axes[1 + len(LEVELS) :]:
        panel.remove()
    put(axes[0], "mean map", mean)
    for panel, level in zip(axes[1:], LEVELS, strict=False):
        panel.imshow(kept_regions(tree, level).numpy(), cmap="tab20", interpolation="nearest")
        panel.set_title(f"regions at {level}/16 and more", fontsize=9)
    draw_tree(figure.add_subplot(2, 1, 2), tree, rounds[-1])
    save(figure, out / "p1-fig4a.png")
    print(f"{int((tree.regions.area > 0).sum())} regions, {len(tree.node)} nodes, "
          f"{int(rounds[-1].choice.selected.sum())} selected")  # fmt: skip


def figure4b(data: Path, out: Path) -> None:
    """The two iterations: error, stability of pixels, of the selected nodes, and the road."""
    image, truth = example(data)
    tree, _, rounds = grown(image)
    cues = program_cues(image)
    figure, axes = panels(4 * len(rounds), 4)
    for number, step in enumerate(rounds, 1):
        nodes = paint_nodes(tree, step.choice.stability.clamp_min(0) * step.choice.selected)
        shown = {
            f"iteration {number}: error (eq. 10)": step.error,
            "stability of pixels (eq. 6)": step.pixels,
            "stability of selected nodes (eq. 8)": nodes,
            "road": agreement(image, cues[f"iteration_{number}"], truth),
        }
        for panel, (title, picture) in zip(axes[4 * (number - 1) :], shown.items(), strict=False):
            put(panel, title, picture)
    save(figure, out / "p1-fig4b.png")


FIGURES: Mapping[str, Callable[[Path, Path], None]] = {
    "p1-fig4a": figure4a,
    "p1-fig4b": figure4b,
}
