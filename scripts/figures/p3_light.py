"""P3, Table II: which colour planes vary with light. Measured, beside P3's signs.

A plane is robust where the road keeps its value. Its measure is how far the median of the road's
pixels moves, over the plane's standard deviation in the images: 0 is no change, 1 as much as
the plane varies in them at all (ours; P3 argues from theory and gives signs only).
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, subsample_dataset
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.metrics import auc, count_levels
from roadtorch.evaluation.uncertainty import mean_interval
from roadtorch.imaging.color import PLANES, color_plane
from roadtorch.oneclass.axes import circular_mean, unroll_hue
from roadtorch.testing.scenes import RenderedScene, render_scene
from scripts.figures.chart import chart, show_table

NAMES = ("R", "G", "B", "nr", "ng", "O1", "O2", "L", "a", "b", "H", "S")

PRINTED = ("R", "G", "B", "nr", "ng", "O1", "O2", "L", "ab", "H", "S")
SIGNS = {
    "global illumination": "-----++-+++",
    "discriminative power": "++--+---+--",
    "distance": "+++++++++++",
    "strong shadows": "-+---++-+++",
    "highlights": "-----++-+++",
    "road type and shape": "+++++++++++",
}
"""P3's Table II as its text has it: a sign for each of the ``PRINTED`` columns."""

SCENES = 12
IMAGES = 36  # of CamVid
ROBUST = 0.25  # a plane has "+" below it; ours
TELLING = 0.75  # AUC from which a plane is discriminative; ours
SHADE = 0.03  # grey levels of 1 that a shadow takes at least


class Pair(NamedTuple):
    """Two images (3, H, W), and the road bool (H, W) that is compared in each."""

    one: Tensor
    other: Tensor
    here: Tensor
    there: Tensor


Row = Mapping[str, object]
"""A property and, by plane, its measure."""

Change = Callable[[int], Pair]
"""A pair of images of the scene with a seed."""

CLEAR: Mapping[str, float] = {"dusk": 0.0, "shadows": 0, "cars": 0}


# --- what is changed --------------------------------------------------------------------


def clear_scene(seed: int, **options: float) -> RenderedScene:
    """Render the scene of a seed at noon, without shadows and cars, but for the options."""
    return render_scene(seed, 120, 160, **{**CLEAR, **options})


def eight_bits(image: Tensor) -> Tensor:
    """Quantise an image as a camera does: in [0,1], at 256 levels."""
    return (image.clamp(0, 1) * 255).round() / 255


def dimmed(seed: int) -> Pair:
    """Halve every channel."""
    scene = clear_scene(seed)
    return Pair(scene.image, eight_bits(scene.image / 2), scene.road, scene.road)


def at_dusk(seed: int) -> Pair:
    """Compare a street at noon and at late dusk, which is darker and redder."""
    noon, dusk = clear_scene(seed), clear_scene(seed, dusk=0.8)
    return Pair(noon.image, dusk.image, noon.road, dusk.road)


def in_shadow(seed: int) -> Pair:
    """Compare a street with and without shadows, in the pixels that they darken."""
    lit, shaded = clear_scene(seed), clear_scene(seed, shadows=3)
    darker = lit.road & ((lit.image - shaded.image).mean(0) > SHADE)
    return Pair(lit.image, shaded.image, darker, darker)


def with_highlight(seed: int) -> Pair:
    """Add white light reflected by the surface: 0.2 in every channel."""
    scene = clear_scene(seed)
    return Pair(scene.image, eight_bits(scene.image + 0.2), scene.road, scene.road)


def near_and_far(seed: int) -> Pair:
    """Compare the lowest and the highest third of the road's rows in one image."""
    scene = clear_scene(seed)
    return Pair(scene.image, scene.image, *thirds(scene.road))


def other_shape(seed: int) -> Pair:
    """Compare the same surface as a straight and as a bent, narrower road."""
    straight = clear_scene(seed, curvature=0.0, road_width=8.0)
    bent = clear_scene(seed, curvature=0.005, road_width=6.0)
    return Pair(straight.image, bent.image, straight.road, bent.road)


def other_road(seed: int) -> Pair:
    """Compare two streets: other asphalt, other houses."""
    street, second = clear_scene(seed), clear_scene(seed + 1)
    return Pair(street.image, second.image, street.road, second.road)


CHANGES: Mapping[str, Change] = {
    "global illumination (halved)": dimmed,
    "global illumination (dusk)": at_dusk,
    "strong shadows": in_shadow,
    "highlights": with_highlight,
    "distance": near_and_far,
    "road type and shape (shape)": other_shape,
    "road type and shape (type)": other_road,
}
"""By property of Table II, how it is changed."""


def thirds(road: Tensor) -> tuple[Tensor, Tensor]:
    """Return the lowest and the highest third of the rows of road bool (H, W), each bool (H, W)."""
    rows = road.any(1).nonzero()[:, 0]
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    third = max(1, (bottom - top) // 3)
    near, far = road.clone(), road.clone()
    near[: bottom - third] = False
    far[top + third :] = False
    return near, far


# --- measures ---------------------------------------------------------------------------


def median_of(values: Tensor, name: str) -> Tensor:
    """Return the median of values (n,) of a plane; of hue along the circle, from the mean."""
    if not PLANES[name].circular:
        return values.median()
    mean = circular_mean(values)
    return (unroll_hue(values, mean).median() + mean).remainder(1)


def distance(values: Tensor, reference: Tensor, name: str) -> Tensor:
    """Return how far values of a plane are from others, ≥ 0; of hue along the circle."""
    return (unroll_hue(values, reference) if PLANES[name].circular else values - reference).abs()


def deviation(values: Tensor, name: str) -> float:
    """Return the standard deviation of values (n,) of a plane."""
    mean = circular_mean(values) if PLANES[name].circular else values.mean()
    return float(distance(values, mean, name).square().mean().sqrt())


def moves(change: Change, seeds: Sequence[int]) -> dict[str, Tensor]:
    """Return how far the road's median moves in each scene, over the plane's deviation: (n,)."""
    pairs = [pair for pair in map(change, seeds) if pair.here.any() and pair.there.any()]
    moved = {}
    for name in NAMES:
        ones = [color_plane(pair.one, name) for pair in pairs]
        others = [color_plane(pair.other, name) for pair in pairs]
        here = [median_of(one[pair.here], name) for one, pair in zip(ones, pairs, strict=True)]
        there = [median_of(two[pair.there], name) for two, pair in zip(others, pairs, strict=True)]
        shifts = distance(torch.stack(here), torch.stack(there), name)
        moved[name] = shifts / deviation(torch.stack(ones).flatten(), name)
    return moved


def discriminative_power(dataset: Dataset) -> dict[str, Tensor]:
    """Return the AUC of one Gaussian in the images of a set that show road, (n,) by plane."""
    read = [dataset.read(item) for item in dataset.items]
    areas = {}
    for name in NAMES:
        detector = load_detector(f"oneclass:gaussian:{name}")
        areas[name] = torch.stack(
            [
                auc(count_levels(detector.detect(image).likelihood, truth.road, truth.valid))
                for image, truth in read
                if truth.road.any()
            ]
        )
    return areas


def drive_rows(dataset: Dataset) -> list[Row]:
    """Return how far the road moves between the drives of a set, and inside of them."""
    read = [(item.group, *dataset.read(item)) for item in dataset.items]
    rows: dict[str, dict[str, float]] = {}
    for name in NAMES:
        values: dict[str, list[Tensor]] = {}
        medians: dict[str, list[Tensor]] = {}
        for drive, image, truth in read:
            if truth.road.any():
                values.setdefault(str(drive), []).append(color_plane(image, name))
                medians.setdefault(str(drive), []).append(
                    median_of(values[str(drive)][-1][truth.road], name)
                )
        unit = fmean(deviation(torch.stack(planes).flatten(), name) for planes in values.values())
        centres = {drive: median_of(torch.stack(planes), name) for drive, planes in medians.items()}
        for first, second in combinations(centres, 2):
            apart = float(distance(centres[first], centres[second], name)) / unit
            rows.setdefault(f"{first} against {second}", {})[name] = apart
        for drive, planes in medians.items():
            apart = float(distance(torch.stack(planes), centres[drive], name).mean()) / unit
            rows.setdefault(f"inside {drive}", {})[name] = apart
    return [{"property": label, **row} for label, row in rows.items()]


# --- the table --------------------------------------------------------------------------


def printed_sign(name: str, of: str) -> str:
    """Return P3's sign for a plane and a property, "+" or "-"; a and b share a column."""
    signs = SIGNS[of.partition(" (")[0]]
    return signs[PRINTED.index("ab" if name in "ab" else name)]


def agreement(rows: Sequence[Row]) -> tuple[int, int]:
    """Count the cells whose measured sign is P3's, and all cells."""
    agrees = [
        (float(str(row[name])) >= TELLING) == (printed_sign(name, of) == "+")
        if (of := str(row["property"])).startswith("discriminative")
        else (float(str(row[name])) < ROBUST) == (printed_sign(name, of) == "+")
        for row in rows
        for name in NAMES
    ]
    return sum(agrees), len(agrees)


def draw_moves(path: Path, rows: Sequence[Row]) -> None:
    """Draw a row of squares a property, the darker the farther the road moves."""
    values = [[float(str(row[name])) for name in NAMES] for row in rows]
    with chart(path, 6.4, 0.5 + 0.21 * len(rows)) as figure:
        axes = figure.subplots()
        axes.grid(visible=False)
        axes.imshow(values, cmap="Greys", vmin=0, vmax=2, aspect="auto")
        axes.set_xticks(range(len(NAMES)), NAMES)
        axes.set_yticks(range(len(rows)), [str(row["property"]) for row in rows])
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        for (y, x), value in np.ndenumerate(values):
            ink = "white" if value > 1 else "black"
            axes.text(x, y, f"{value:.2f}", ha="center", va="center", fontsize=6.5, color=ink)


def table2(data: Path, out: Path) -> None:
    """Write P3's Table II: shift of the road in each plane when light, place or shape change."""
    few = subsample_dataset(open_dataset("camvid", data / "camvid"), IMAGES)
    measured = {name: moves(change, range(SCENES)) for name, change in CHANGES.items()}
    measured["discriminative power (AUC)"] = discriminative_power(few)
    rows: list[Row] = []
    table: list[Row] = []
    for of, values in measured.items():
        rows.append({"property": of} | {name: float(values[name].mean()) for name in NAMES})
        ends = {name: "{:.2f} to {:.2f}".format(*mean_interval(values[name])) for name in NAMES}
        signs = {name: printed_sign(name, of) for name in NAMES}
        table += [rows[-1], {"property": "  95 %", **ends}, {"property": "  P3", **signs}]
    show_table(out / "p3-table2.csv", table)
    print("Signs as P3's: {} of {}\n".format(*agreement(rows)))
    moved = drive_rows(few)
    show_table(out / "p3-table2-camvid.csv", moved)
    draw_moves(out / "p3-table2.png", [*rows[: len(CHANGES)], *moved])
