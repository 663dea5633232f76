"""P3, Table II: which colour planes vary with light. Measured, beside P3's signs.

A plane is robust where the road keeps its value. Its measure is how far the median of the road's
pixels moves, over the plane's standard deviation in the pictures: 0 is no change, 1 as much as
the plane varies in them at all (ours; P3 argues from theory and gives signs only).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.imaging.color import plane
from roadtorch.testing.scenes import RenderedScene, render_scene
from scripts.figures.chart import apart, area_of, chart, middle, open_sets, spread, tell

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
PICTURES = 36  # of CamVid
ROBUST = 0.25  # a plane has "+" below it; ours
TELLING = 0.75  # AUC from which a plane is discriminative; ours
SHADE = 0.03  # grey levels of 1 that a shadow takes at least


class Pair(NamedTuple):
    """Two images (3,H,W), and the road bool (H,W) that is compared in each."""

    one: Tensor
    other: Tensor
    here: Tensor
    there: Tensor


Row = Mapping[str, object]
"""A property and, by plane, its measure."""

Change = Callable[[int], Pair]
"""A pair of pictures of the scene with a seed."""

CLEAR: Mapping[str, float] = {"dusk": 0.0, "shadows": 0, "cars": 0}


# --- what is changed --------------------------------------------------------------------


def clear_scene(seed: int, **options: float) -> RenderedScene:
    """The scene of a seed at noon, without shadows and cars, but for the options."""
    return render_scene(seed, 120, 160, **{**CLEAR, **options})


def eight_bits(image: Tensor) -> Tensor:
    """What a camera would make of an image: in [0,1], at 256 levels."""
    return (image.clamp(0, 1) * 255).round() / 255


def dimmed(seed: int) -> Pair:
    """Half of every channel."""
    scene = clear_scene(seed)
    return Pair(scene.image, eight_bits(scene.image / 2), scene.road, scene.road)


def at_dusk(seed: int) -> Pair:
    """The same street at noon and at late dusk, which is darker and redder."""
    noon, dusk = clear_scene(seed), clear_scene(seed, dusk=0.8)
    return Pair(noon.image, dusk.image, noon.road, dusk.road)


def in_shadow(seed: int) -> Pair:
    """The same street with and without shadows across it: the pixels that they darken."""
    lit, shaded = clear_scene(seed), clear_scene(seed, shadows=3)
    darker = lit.road & ((lit.image - shaded.image).mean(0) > SHADE)
    return Pair(lit.image, shaded.image, darker, darker)


def with_highlight(seed: int) -> Pair:
    """White light reflected by the surface: 0.2 more in every channel."""
    scene = clear_scene(seed)
    return Pair(scene.image, eight_bits(scene.image + 0.2), scene.road, scene.road)


def near_and_far(seed: int) -> Pair:
    """The lowest and the highest third of the road's rows in one picture."""
    scene = clear_scene(seed)
    return Pair(scene.image, scene.image, *thirds(scene.road))


def other_shape(seed: int) -> Pair:
    """The same surface as a straight and as a bent, narrower road."""
    straight = clear_scene(seed, curvature=0.0, road_width=8.0)
    bent = clear_scene(seed, curvature=0.005, road_width=6.0)
    return Pair(straight.image, bent.image, straight.road, bent.road)


def other_road(seed: int) -> Pair:
    """Another street altogether: other asphalt, other houses."""
    one, other = clear_scene(seed), clear_scene(seed + 1)
    return Pair(one.image, other.image, one.road, other.road)


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
    """The lowest and the highest third of the rows of road bool (H,W), each bool (H,W)."""
    rows = road.any(1).nonzero()[:, 0]
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    third = max(1, (bottom - top) // 3)
    near, far = road.clone(), road.clone()
    near[: bottom - third] = False
    far[top + third :] = False
    return near, far


# --- what is measured -------------------------------------------------------------------


def moves(change: Change, seeds: Sequence[int]) -> dict[str, float]:
    """By plane, how far the road's median moves, over the plane's deviation in the pictures."""
    pairs = [pair for pair in map(change, seeds) if pair.here.any() and pair.there.any()]
    found = {}
    for name in NAMES:
        ones = [plane(pair.one, name) for pair in pairs]
        others = [plane(pair.other, name) for pair in pairs]
        shifts = [
            float(apart(middle(one[pair.here], name), middle(other[pair.there], name), name))
            for one, other, pair in zip(ones, others, pairs, strict=True)
        ]
        found[name] = fmean(shifts) / spread(torch.stack(ones).flatten(), name)
    return found


def telling(pictures: Sequence[tuple[Tensor, Tensor, Tensor]]) -> dict[str, float]:
    """By plane, the mean AUC of one Gaussian; pictures as (image, road, valid)."""
    return {
        name: fmean(area_of(f"oneclass:gaussian:{name}", *picture) for picture in pictures)
        for name in NAMES
    }


# --- CamVid's drives --------------------------------------------------------------------


class Drive(NamedTuple):
    """By plane: the road's median in each picture (n,), near and far, and the deviation of all."""

    road: dict[str, Tensor]
    near: dict[str, Tensor]
    far: dict[str, Tensor]
    all: dict[str, float]


def read_drive(dataset: Dataset, group: str) -> Drive:
    """The planes of a drive's pictures that show road."""
    read = [dataset.read(item) for item in dataset.items if item.group == group]
    seen = [(image, truth) for image, truth in read if truth.road.any()]
    ends = [thirds(truth.road) for _, truth in seen]
    drive = Drive({}, {}, {}, {})
    for name in NAMES:
        values = [plane(image, name) for image, _ in seen]
        drive.all[name] = spread(torch.cat([one.flatten() for one in values]), name)
        for into, masks in (
            (drive.road, [truth.road for _, truth in seen]),
            (drive.near, [near for near, _ in ends]),
            (drive.far, [far for _, far in ends]),
        ):
            found = [middle(one[mask], name) for one, mask in zip(values, masks, strict=True)]
            into[name] = torch.stack(found)
    return drive


def drive_rows(drives: Mapping[str, Drive]) -> Iterator[Row]:
    """How far the road moves between the drives, inside of them and from near to far."""
    unit = {name: fmean(one.all[name] for one in drives.values()) for name in NAMES}
    centres = {
        drive: {name: middle(one.road[name], name) for name in NAMES}
        for drive, one in drives.items()
    }
    for one, other in combinations(drives, 2):
        yield {"property": f"{one} against {other}"} | {
            name: float(apart(centres[one][name], centres[other][name], name)) / unit[name]
            for name in NAMES
        }
    for drive, found in drives.items():
        yield {"property": f"inside {drive}"} | {
            name: float(apart(found.road[name], centres[drive][name], name).mean()) / unit[name]
            for name in NAMES
        }
    yield {"property": "distance, CamVid"} | {
        name: fmean(float(apart(d.near[name], d.far[name], name).mean()) for d in drives.values())
        / unit[name]
        for name in NAMES
    }


# --- the table --------------------------------------------------------------------------


def printed_sign(name: str, of: str) -> str:
    """P3's sign for a plane and a property, "+" or "-"; a and b share a column."""
    signs = SIGNS[of.partition(" (")[0]]
    return signs[PRINTED.index("ab" if name in "ab" else name)]


def agreement(rows: Sequence[Row]) -> tuple[int, int]:
    """In how many cells the measured sign is P3's, of how many."""
    same = [
        (float(str(row[name])) >= TELLING) == (printed_sign(name, of) == "+")
        if (of := str(row["property"])).startswith("discriminative")
        else (float(str(row[name])) < ROBUST) == (printed_sign(name, of) == "+")
        for row in rows
        for name in NAMES
    ]
    return sum(same), len(same)


def sign_rows(rows: Sequence[Row]) -> Iterator[Row]:
    """Each row followed by P3's signs."""
    for row in rows:
        yield dict(row)
        signs = {name: printed_sign(name, str(row["property"])) for name in NAMES}
        yield {"property": "  P3", **signs}


def measured_rows(dataset: Dataset, seeds: Sequence[int]) -> list[Row]:
    """The rows of Table II on rendered scenes; discriminative power on the set as well."""
    scenes = [clear_scene(seed) for seed in seeds]
    read = [dataset.read(item) for item in dataset.items]
    rows: list[Row] = [
        {"property": name, **moves(change, seeds)} for name, change in CHANGES.items()
    ]
    shown = [(one.image, one.road, ~one.void) for one in scenes]
    rows.append({"property": "discriminative power (AUC, scenes)", **telling(shown)})
    seen = [(image, truth.road, truth.valid) for image, truth in read if truth.road.any()]
    return [*rows, {"property": "discriminative power (AUC, CamVid)", **telling(seen)}]


def draw_moves(path: Path, rows: Sequence[Row]) -> None:
    """A row of squares a property, the darker the farther the road moves."""
    values = [[float(str(row[name])) for name in NAMES] for row in rows]
    with chart(path, 6.4, 0.5 + 0.21 * len(rows)) as figure:
        axes = figure.subplots()
        axes.grid(visible=False)
        axes.imshow(values, cmap="Greys", vmin=0, vmax=2, aspect="auto")
        axes.set_xticks(range(len(NAMES)), NAMES)
        axes.set_yticks(range(len(rows)), [str(row["property"]) for row in rows])
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        for y, row in enumerate(values):
            for x, value in enumerate(row):
                ink = "white" if value > 1 else "black"
                axes.text(x, y, f"{value:.2f}", ha="center", va="center", fontsize=6.5, color=ink)


def table2(data: Path, out: Path) -> None:
    """P3, Table II: how far the road moves in each plane when light, place or shape change."""
    (camvid,) = open_sets(data, "camvid")
    few = every_kth(camvid, PICTURES)
    rows = measured_rows(few, range(SCENES))
    tell(out / "p3-table2.csv", ("property", *NAMES), list(sign_rows(rows)))
    print("Signs as P3's: {} of {}\n".format(*agreement(rows)))
    drives = {name: read_drive(few, name) for name in few.groups()}
    moved = list(drive_rows(drives))
    tell(out / "p3-table2-camvid.csv", ("property", *NAMES), moved)
    draw_moves(out / "p3-table2.png", [*rows[: len(CHANGES)], *moved])
