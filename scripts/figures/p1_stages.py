"""P1, Figs. 1 to 5: the stages on one free image, and masks over free streets with their truth."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from torch import Tensor
from torch.nn.functional import avg_pool2d

from roadtorch.base.image import read_image, to_pixels
from roadtorch.data.dataset import Truth
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.ufl import UflSettings
from roadtorch.evaluation.metrics import count_mask, f_measure
from roadtorch.evaluation.report.montage import apply_colormap
from roadtorch.evaluation.uncertainty import mean_interval
from roadtorch.ufl.feature_maps import dictionary_image, learn_features, make_encoder, mean_map
from roadtorch.ufl.hierarchy import (
    RegionTree,
    build_tree,
    paint_nodes,
    region_thresholds,
    threshold_regions,
)
from roadtorch.ufl.preprocess import WorkingShape, equalise, resize_bicubic
from roadtorch.ufl.road import Round, dilate, find_road, mask_to_image
from scripts.figures.chart import chart, show_table
from scripts.figures.p1 import open_small, resize_as_p1, score_variants
from scripts.figures.sheets import read_labelled, write_sheet

EXAMPLE = "udadv_test5.jpg"
"""Of unlabelled_free/: a motorway with its road in the sun and in the shade of trees."""

PROGRAM = UflSettings()  # of the authors' program
WIDE = 213, 120  # pixels of a tile of EXAMPLE, twice its size at which P1 works
IMAGES = 18  # of CamVid, for what is measured
YELLOW, RED, GREEN = (1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
STRENGTH = 0.5  # of a colour over the image


def read_example(data: Path) -> Tensor:
    """Read the image of Figs. 1 to 4 at P1's size, (3, 120, W)."""
    image = read_image(data / "unlabelled_free" / EXAMPLE)
    return resize_bicubic(image, WorkingShape().size(*image.shape[-2:]))


def tile(values: Tensor) -> np.ndarray:
    """Draw an image (3, H, W) in [0, 1], or a map (H, W) from its minimum to its maximum."""
    if values.ndim == 3:
        return to_pixels(values.clamp(0, 1))
    values = values.float() - values.min()
    return apply_colormap(values / values.max().clamp_min(1e-9))


def blend(image: Tensor, areas: Mapping[tuple[float, float, float], Tensor]) -> Tensor:
    """Tint areas, bool (H, W) by colour, of an image (3, H, W)."""
    for colour, area in areas.items():
        tint = image.new_tensor(colour)[:, None, None]
        image = torch.where(area, (1 - STRENGTH) * image + STRENGTH * tint, image)
    return image


def blend_result(image: Tensor, mask: Tensor, truth: Truth) -> Tensor:
    """Tint an image (3, H, W) as P1's Fig. 5: yellow correct, red too much, green missed."""
    dimmed = torch.where(truth.valid, image, image / 3)
    road, mask = truth.road, mask & truth.valid
    return blend(dimmed, {YELLOW: mask & road, RED: mask & ~road, GREEN: road & ~mask})


def fig1(data: Path, out: Path) -> None:
    """Write P1's Fig. 1: the framework on a free image, stage by stage."""
    image = read_example(data)
    detection = load_detector("ufl:original").detect(image)
    rows = {
        "input; blurred and equalised; dictionary, best base first; selected feature maps": (
            *(image, detection.cues["equalised"]),
            *(detection.cues["dictionary"], detection.cues["selected_maps"]),
        ),
        "their mean; thresholds survived; stability of the selected nodes; road": (
            *(detection.cues["mean_map"], detection.cues["tree_levels"]),
            *(detection.cues["node_stability"], blend(image, {YELLOW: detection.mask})),
        ),
    }
    sheet = {caption: [tile(values) for values in row] for caption, row in rows.items()}
    write_sheet(out / "p1-fig1.jpg", sheet, WIDE)


# --- Fig. 2 -----------------------------------------------------------------------------

PATCH = 12  # side of the road patches, pixels of 160×120
PATCHES = 4


def road_patches(road: Tensor, count: int = PATCHES, side: int = PATCH) -> list[tuple[int, int]]:
    """Return upper left corners of squares inside road bool (H, W), from far to near.

    None where no square of that side fits.
    """
    fits = avg_pool2d(road.float()[None], side, 1)[0] == 1
    rows = fits.any(1).nonzero()[:, 0]
    if not len(rows):
        return []
    chosen = rows[torch.linspace(0, len(rows) - 1, count).round().long()].tolist()
    columns = [fits[row].nonzero()[:, 0] for row in chosen]
    return [(row, int(fit[len(fit) // 2])) for row, fit in zip(chosen, columns, strict=True)]


def crop_patch(image: Tensor, corner: tuple[int, int]) -> Tensor:
    """Return the patch (3, PATCH, PATCH) of an image at its upper left corner."""
    row, column = corner
    return image[:, row : row + PATCH, column : column + PATCH]


def unevenness(image: Tensor, corners: Sequence[tuple[int, int]]) -> tuple[float, float]:
    """Return the deviation of patches' brightness, and of their textures', over the mean."""
    patches = torch.stack([crop_patch(image, corner).mean(0) for corner in corners])
    level = patches.mean()
    texture = patches.flatten(1).std(1)
    return float(patches.mean((1, 2)).std() / level), float(texture.std() / level)


def fig2(data: Path, out: Path) -> None:
    """Write P1's Fig. 2: road patches, far to near, without and after preprocessing.

    The road is that of `fusion`; the table measures the true road of CamVid.
    """
    image = read_example(data)
    corners = road_patches(load_detector("fusion").detect(image).mask)
    even = equalise(image, PROGRAM.smoothing)
    rows = {
        f"{title} preprocessing: image, and its road from far to near": [
            tile(part) for part in (pixels, *(crop_patch(pixels, corner) for corner in corners))
        ]
        for title, pixels in {"without": image, "after": even / (2 * even.mean())}.items()
    }
    write_sheet(out / "p1-fig2.jpg", rows, (WIDE[0] // 5 * 4, WIDE[1] // 5 * 4))
    few = open_small(data, "camvid", IMAGES)
    measured: dict[str, list[tuple[float, float]]] = {"without": [], "after": []}
    for item in few.items:
        small, truth = few.read(item)
        if corners := road_patches(truth.road & truth.valid):
            measured["without"].append(unevenness(small, corners))
            measured["after"].append(unevenness(equalise(small, PROGRAM.smoothing), corners))
    table = []
    for title, values in measured.items():
        row: dict[str, object] = {"preprocessing": title, "images": len(values)}
        for name, column in zip(("brightness", "texture"), torch.tensor(values).T, strict=True):
            row |= {f"{name} differs by": float(column.mean())}
            row |= {f"{name}, 95 %": "{:.3f} to {:.3f}".format(*mean_interval(column))}
        table.append(row)
    show_table(out / "p1-fig2.csv", table)


# --- Fig. 3 -----------------------------------------------------------------------------

EQUATIONS = {"eq. 3": "patch", "eq. 4": "base"}


def encoded_maps(image: Tensor, encoder: str) -> tuple[Tensor, Tensor, Tensor]:
    """Return all maps (K, h, w) by eq. 3 or 4, the bases' order (K,), and the bases (K, d)."""
    maps = PROGRAM.maps.model_copy(update={"encoder": encoder})
    learned = learn_features(image, PROGRAM.smoothing, PROGRAM.dictionary, maps)
    encode = make_encoder(learned.patches, learned.dictionary, maps.encoder)
    values = encode(learned.dictionary).view(-1, *learned.size)
    return values, learned.maps.order, learned.dictionary


def fig3(data: Path, out: Path) -> None:
    """Write P1's Fig. 3: the dictionary, maps of four bases by eqs. 3 and 4; F with either."""
    image = read_example(data)
    values, order, dictionary = encoded_maps(image, "base")
    ranks = [0, len(order) // 3, 2 * len(order) // 3, len(order) - 1]
    maps = {"eq. 3": encoded_maps(image, "patch")[0], "eq. 4": values}
    boards = (torch.arange(len(order)), order)
    side, size = PROGRAM.dictionary.side, (values.shape[1], values.shape[2])
    captions = ("(a) dictionary; (b) maps by", "(c) by score, eq. 5; (b) the same maps by")
    rows = {
        f"{caption} {title}, bases of rank 1, 67, 134, 200": [
            tile(dictionary_image(dictionary, board, side, size)),
            *(tile(maps[title][int(order[rank])]) for rank in ranks),
        ]
        for caption, board, title in zip(captions, boards, EQUATIONS, strict=True)
    }
    write_sheet(out / "p1-fig3.jpg", rows, (WIDE[0] // 5 * 4, WIDE[1] // 5 * 4))
    variants = {
        title: ("ufl:original", {"maps": {"encoder": kind}}) for title, kind in EQUATIONS.items()
    }
    table = score_variants(open_small(data, "camvid", IMAGES), variants)
    zeros = {title: float((values == 0).double().mean()) for title, values in maps.items()}
    show_table(out / "p1-fig3.csv", [{**row, "zeros": zeros[str(row["method"])]} for row in table])


# --- Fig. 4 -----------------------------------------------------------------------------

SELECTED, POSITIVE, OTHER = "#d55e00", "#0072b2", "#999999"
LEVELS = (2, 5, 8)  # thresholds, in sixteenths, whose regions are shown


def grow(image: Tensor) -> tuple[RegionTree, Tensor, list[Round]]:
    """Return the tree of the authors' program on an image, the mean map, and the iterations."""
    learned = learn_features(image, PROGRAM.smoothing, PROGRAM.dictionary, PROGRAM.maps)
    mean = mean_map(learned.maps.maps, PROGRAM.maps.scale)
    steps = region_thresholds(PROGRAM.tree.levels, PROGRAM.tree.top)
    tree = build_tree(threshold_regions(mean, steps), PROGRAM.tree.min_area, PROGRAM.tree.nodes)
    return tree, mean, find_road(learned.maps.maps, mean, tree, PROGRAM.road)


def node_columns(parents: Sequence[int]) -> list[float]:
    """Return where each node is drawn: leaves side by side, parents over their children.

    ``parents`` are indices, smaller than their children's; -1 for the root.
    """
    children: dict[int, list[int]] = {}
    for node, parent in enumerate(parents):
        children.setdefault(parent, []).append(node)
    columns = [0.0] * len(parents)

    def leaves(node: int) -> Iterator[int]:
        for child in children.get(node, ()):
            yield from leaves(child)
        if node not in children:
            yield node

    for number, leaf in enumerate(leaves(0)):
        columns[leaf] = float(number)
    for node in reversed(range(len(parents))):
        if below := children.get(node):
            columns[node] = fmean(columns[child] for child in below)
    return columns


def draw_tree(axes: Axes, tree: RegionTree, last: Round) -> None:
    """Draw nodes as bars from their first level to their last, joined to their parents."""
    parents, columns = tree.parent.tolist(), node_columns(tree.parent.tolist())
    spans = [tree.regions.level[tree.node_of == node].aminmax() for node in range(len(parents))]
    spans = [(int(span.min), int(span.max)) for span in spans]
    chosen, stability = last.choice.selected.tolist(), last.choice.stability.tolist()
    for node, (column, (first, deepest)) in enumerate(zip(columns, spans, strict=True)):
        colour = SELECTED if chosen[node] else POSITIVE if stability[node] > 0 else OTHER
        area = int(tree.regions.area[tree.node[node]]) / tree.regions.labels[0].numel()
        ends, width = [first - 0.3, deepest + 0.3], 1 + 12 * area**0.5
        axes.plot([column] * 2, ends, color=colour, linewidth=width, solid_capstyle="butt")
        if node:
            above, bottom = columns[parents[node]], spans[parents[node]][1]
            rise = [bottom + 0.3, bottom + 0.5, bottom + 0.5, first - 0.3]
            axes.plot([above, above, column, column], rise, color="black", linewidth=0.6)
    axes.set(xticks=[], ylabel="threshold, sixteenths")
    axes.set_title("nodes: selected orange, of positive stability blue; width by area")
    axes.grid(visible=False)
    axes.invert_yaxis()


def fig4(data: Path, out: Path) -> None:
    """Write P1's Fig. 4: (a) regions above rising thresholds, their tree; (b) the iterations."""
    image = read_example(data)
    tree, mean, rounds = grow(image)
    regions = tree.node_of + 1
    with chart(out / "p1-fig4a.png", 6.4, 3.2) as figure:
        halves: Any = figure.subfigures(2, 1, height_ratios=[1, 2])
        above, below = halves
        for axes, level in zip(above.subplots(1, 1 + len(LEVELS)), (None, *LEVELS), strict=True):
            axes.set_axis_off()
            values = mean if level is None else regions[tree.regions.labels[level].long()]
            colours = "cividis" if level is None else "tab20"
            axes.imshow(values.numpy(), cmap=colours, interpolation="nearest")
            axes.set_title("mean map" if level is None else f"regions at {level}/16")
        draw_tree(below.subplots(), tree, rounds[-1])
    side, rows = PROGRAM.dictionary.side, {}
    for number, step in enumerate(rounds, 1):
        stability = step.choice.stability.clamp_min(0) * step.choice.selected
        road = mask_to_image(dilate(step.road, PROGRAM.road.dilation), side)
        title = f"iteration {number}: error (eq. 10); pixels' stability (eq. 6); selected nodes'"
        maps = step.error, step.pixels, paint_nodes(tree, stability), blend(image, {YELLOW: road})
        rows[f"{title} stability (eq. 8); road"] = [*map(tile, maps)]
    write_sheet(out / "p1-fig4b.jpg", rows, WIDE)


# --- Fig. 5 -----------------------------------------------------------------------------

METHODS = ("vanishing-point", "kmeans-road", "ufl:original", "ufl")
"""The three of Table I in its order, and our best reading."""


def fig5(data: Path, out: Path) -> None:
    """Write P1's Fig. 5: masks of the methods of Table I over free images with labels."""
    streets = [resize_as_p1(*street) for street in read_labelled(data)]
    rows = {"input": [to_pixels(image) for image, _ in streets]}
    for name in METHODS:
        detector = load_detector(name)
        masks = [detector.detect(image).mask for image, _ in streets]
        pairs = list(zip(masks, streets, strict=True))
        counts = [count_mask(mask, truth.road, truth.valid) for mask, (_, truth) in pairs]
        scores = ", ".join(f"{float(f_measure(count)):.2f}" for count in counts)
        tinted = (blend_result(image, mask, truth) for mask, (image, truth) in pairs)
        rows[f"{name}: F {scores}"] = [*map(to_pixels, tinted)]
    write_sheet(out / "p1-fig5.jpg", rows, (150, 112))
