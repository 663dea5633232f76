"""Rendered streets of many kinds, with their truth, for training without a label by people.

    python train/rendered_streets.py --count 160 --pictures PICTURES --truth TRUTH

writes PICTURES/KIND_NUMBER.png and TRUTH/KIND_NUMBER.png.npz for each kind (streets, tracks,
motorways, yards). TRUTH is laid into the folder of prepared pictures of a training run: what is
there already is not labelled again, so the truth stands in the machine labels' place
(configs/layout-free.toml).

What is added to ``roadtorch.scenes.street`` is variety: tracks with ruts and frayed edges,
motorways with shoulders and barriers, squares with many cars and lorries, hills and woods on the
horizon, other skies, and on every third picture an ego car below.
"""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.imaging.resize import resized
from roadtorch.io.atomic import make_folder
from roadtorch.scenes.canvas import (
    BUILDING,
    CAR,
    PAVEMENT,
    ROAD,
    TREE,
    Canvas,
    RenderedScene,
    cloth,
    developed,
    draw_street,
    seen_ground,
)
from roadtorch.scenes.street import (
    Ground,
    paint_cars,
    paint_ground,
    paint_side,
    paint_sky,
    paint_tree,
    sample,
    shadow,
    write_picture,
)
from roadtorch.train.prepared import SOURCE, Arrays, to_bytes, write_arrays

HEIGHT, WIDTH = 240, 320
"""Of the pictures."""

PREPARED = (120, 160)
"""Of the truth: the size at which the network works (configs/layout-free.toml)."""

BONNETS = 0.34
"""Share of the pictures that show an ego car."""

Random = np.random.Generator

EARTHS = np.array(
    [
        [0.5, 0.45, 0.38],  # gravel
        [0.62, 0.52, 0.38],  # sand
        [0.42, 0.32, 0.24],  # soil
        [0.45, 0.44, 0.43],  # old asphalt
        [0.66, 0.64, 0.6],  # limestone, concrete
        [0.5, 0.34, 0.25],  # red earth
        [0.3, 0.27, 0.23],  # mud
    ]
)
GREENS = np.array(
    [
        [0.28, 0.38, 0.16],
        [0.36, 0.42, 0.2],
        [0.5, 0.47, 0.27],  # dry grass
        [0.62, 0.56, 0.36],  # straw
        [0.36, 0.28, 0.18],  # leaves on the ground
        [0.2, 0.27, 0.12],
        [0.52, 0.46, 0.4],  # stones
    ]
)


def drawn(colours: np.ndarray, at: Random) -> np.ndarray:
    """One of some colours, lighter or darker, with a tint of its own."""
    return (
        colours[at.integers(len(colours))] * at.uniform(0.7, 1.35) * np.exp(at.normal(0, 0.05, 3))
    )


# --- what surrounds the road ------------------------------------------------------------


def paint_other_sky(canvas: Canvas, at: Random) -> None:
    """White, grey, deep blue or red instead of pale blue, at times."""
    paint_sky(canvas, at)
    if at.random() < 0.45:
        top = np.array(
            [[0.92, 0.93, 0.95], [0.62, 0.65, 0.7], [0.25, 0.42, 0.75], [0.9, 0.7, 0.55]]
        )
        colour = top[at.integers(len(top))] * at.uniform(0.9, 1.08)
        clouds = cv2.resize(cloth(at, octaves=4), (canvas.width, canvas.height))[..., None]
        share = at.uniform(0.5, 0.95)
        canvas.rgb[:] = canvas.rgb * (1 - share) + share * colour * (1 + 0.05 * clouds)


def paint_horizon(canvas: Canvas, at: Random) -> None:
    """Far hills, woods or roofs along the horizon, one to three rows of them."""
    columns = np.arange(canvas.width)
    for _ in range(int(at.integers(1, 4))):
        profile = cloth(at, octaves=int(at.integers(2, 5)))[0]
        line = np.interp(columns, np.linspace(0, canvas.width, profile.size), profile)
        if at.random() < 0.3:
            line = np.round(line * 2) / 2  # roofs
        tall = canvas.height * at.uniform(0.01, 0.16) * (1 + 0.5 * line)
        rows = np.arange(canvas.height)[:, None]
        where = (rows > canvas.horizon - tall) & (rows <= canvas.horizon + 2)
        leaves = cv2.resize(cloth(at, 128, 4), (canvas.width, canvas.height))[..., None]
        colour = drawn(np.vstack([GREENS, [[0.45, 0.5, 0.58], [0.6, 0.55, 0.5]]]), at)
        canvas.fill(where, np.clip(colour * (1 + 0.2 * leaves), 0, 1).astype(np.float32), TREE)


def paint_bushes(canvas: Canvas, edge: float, at: Random) -> None:
    """Bushes, hedges and trees on both sides, the farthest first."""
    tall = at.uniform(0.4, 5)
    colour = drawn(GREENS, at)
    for ahead in sorted(at.uniform(3.5, 60, int(at.integers(6, 45))), reverse=True):
        side = at.choice([-1.0, 1.0])
        aside = side * (edge + at.exponential(at.uniform(0.6, 4)) + 0.3)
        if at.random() < 0.15:
            paint_tree(canvas, aside + side, ahead, at)
            continue
        high, wide = tall * at.uniform(0.4, 1.3), at.uniform(0.3, 1.6)
        turn = np.linspace(0, np.pi, 11)
        frayed = 1 + 0.25 * at.standard_normal(turn.size)
        right = float(canvas.street.middle(ahead)) + aside + side * wide
        ring = zip(right + wide * frayed * np.cos(turn), high * frayed * np.sin(turn), strict=True)
        leaves = cv2.resize(cloth(at, 128, 4), (canvas.width, canvas.height))[..., None]
        picture = colour * at.uniform(0.75, 1.2) * (1 + 0.3 * leaves)
        corners = [canvas.project(x, max(y, 0.0), ahead) for x, y in ring]
        canvas.polygon(corners, np.clip(picture, 0, 1).astype(np.float32), TREE)


def paint_barrier(canvas: Canvas, across: float, at: Random) -> None:
    """A wall, a fence or a guard rail along the road."""
    steps = np.concatenate([np.arange(2.5, 20, 0.5), np.arange(20, 90, 5)])
    low, high = (0.45, 0.8) if at.random() < 0.4 else (0.0, at.uniform(0.6, 4))
    colour = np.full(3, at.uniform(0.35, 0.8)) * np.exp(at.normal(0, 0.06, 3))
    places = [(float(canvas.street.middle(z)) + across, z) for z in steps]
    upper = [canvas.project(x, high, z) for x, z in places]
    lower = [canvas.project(x, low, z) for x, z in places]
    canvas.polygon([*upper, *reversed(lower)], np.clip(colour, 0, 1), BUILDING)


def paint_lorry(canvas: Canvas, at: Random) -> None:
    """A box on wheels, as high as a van or a lorry, anywhere on the road."""
    ahead, half = at.uniform(7, 40), canvas.street.road_width / 2
    right = float(canvas.street.middle(ahead)) + at.uniform(-half, half)
    wide, high, long = at.uniform(0.8, 1.3), at.uniform(1.6, 3.8), at.uniform(3, 9)
    colour = np.clip(at.uniform(0.1, 0.9) + at.normal(0, 0.12, 3), 0.03, 0.95)
    for behind, tone in ((long, colour * 0.7), (0.0, colour)):
        corners = [(-wide, 0.3), (wide, 0.3), (wide, high), (-wide, high)]
        points = [canvas.project(right + x, y, ahead + behind) for x, y in corners]
        canvas.polygon(points, tone, CAR)
    for x in (-wide, wide - 0.35):
        tyre = [(x, 0.0), (x + 0.35, 0.0), (x + 0.35, 0.45), (x, 0.45)]
        canvas.polygon(
            [canvas.project(right + a, b, ahead) for a, b in tyre], np.full(3, 0.06), CAR
        )


# --- the ground -------------------------------------------------------------------------


def paint_track(canvas: Canvas, place: Ground, at: Random) -> None:
    """A track with frayed edges, ruts and a strip of grass, through grass, stones or leaves."""
    street, ahead = canvas.street, place.ahead
    below = np.broadcast_to(
        np.arange(canvas.height)[:, None] + 0.5 > canvas.horizon, canvas.classes.shape
    )
    fine, coarse = cloth(at), cloth(at, octaves=3)
    fade = np.clip(at.uniform(3, 12) / ahead, 0.2, 1)
    grain = sample(fine, place.right * 23, place.forward * 23) * fade
    patches = sample(coarse, place.right * 6, place.forward * 6)
    frayed = at.uniform(0, 0.35) * sample(coarse, place.right * 14 + 91, place.forward * 14)
    beside = np.abs(place.across) + frayed - street.road_width / 2
    verge, earth = drawn(GREENS, at), drawn(EARTHS, at)
    rough, even = at.uniform(0.08, 0.35), at.uniform(0.03, 0.16)
    canvas.fill(below, verge, PAVEMENT)
    canvas.rgb[below] *= (1 + rough * grain + 0.12 * patches)[below][:, None]
    road = below & (beside < 0)
    surface = earth * (1 + even * grain + at.uniform(0.02, 0.1) * patches)[..., None]
    if at.random() < 0.45:  # a strip of grass between the wheels
        strip = np.exp(-((place.across / at.uniform(0.2, 0.5)) ** 2)) * at.uniform(0.2, 0.9)
        surface = surface * (1 - strip[..., None]) + strip[..., None] * verge
    if at.random() < 0.5:  # ruts
        ruts = np.exp(-(((np.abs(place.across) - at.uniform(0.6, 0.9)) / 0.22) ** 2))
        surface = surface * (1 - at.uniform(-0.25, 0.3) * ruts)[..., None]
    canvas.fill(road, surface.astype(np.float32), ROAD)
    canvas.rgb[below] *= dappled(canvas, place, at)[below][:, None]


def dappled(canvas: Canvas, place: Ground, at: Random) -> np.ndarray:
    """The light on the ground (H,W): bands of shadow, or the spots of light under trees."""
    light = shadow(at, canvas.street, place.across, place.along)
    if at.random() < 0.35:
        spots = sample(cloth(at, octaves=4), place.right * 12, place.forward * 12)
        light = light * np.where(spots > at.uniform(-1, 1.2), at.uniform(0.35, 0.8), 1)
    return light


def paint_motorway(canvas: Canvas, place: Ground, at: Random) -> None:
    """Asphalt with lanes and hard shoulders, a verge of grass or straw beside it."""
    street = canvas.street
    below = np.broadcast_to(
        np.arange(canvas.height)[:, None] + 0.5 > canvas.horizon, canvas.classes.shape
    )
    beside = np.abs(place.across) - street.road_width / 2
    grain = sample(cloth(at), place.right * 23, place.forward * 23) * np.clip(
        8 / place.ahead, 0.15, 1
    )
    patches = sample(cloth(at, octaves=3), place.right * 5, place.forward * 2)
    canvas.fill(below, drawn(GREENS, at), PAVEMENT)
    canvas.rgb[below] *= (1 + 0.15 * grain + 0.1 * patches)[below][:, None]
    grey = np.full(3, at.uniform(0.18, 0.6)) * np.exp(at.normal(0, 0.02, 3))
    road = below & (beside < 0)
    lane = at.uniform(2.8, 3.9)
    strips = np.floor(place.across / lane + 50).astype(int) % 7
    tones = 1 + at.normal(0, at.uniform(0, 0.08), 7)[strips]  # each lane of its own age
    surface = grey * (tones * (1 + 0.05 * grain + 0.04 * patches))[..., None]
    canvas.fill(road, surface.astype(np.float32), ROAD)
    width = 0.06 + place.ahead / 800
    off = np.abs((place.across / lane + 50) % 1 - 0.5) * lane - lane / 2
    dashed = (np.abs(off) < width) & ((place.along + at.uniform(0, 12)) % at.uniform(6, 14) < 3.5)
    solid = np.abs(beside + at.uniform(0.3, 2.5)) < width
    mark = np.array([[0.88, 0.88, 0.85], [0.85, 0.68, 0.2]])[int(at.random() < 0.25)]
    canvas.rgb[road & (dashed | solid)] = mark * at.uniform(0.6, 1)
    canvas.rgb[below] *= dappled(canvas, place, at)[below][:, None]


# --- the four kinds ---------------------------------------------------------------------


def place_of(canvas: Canvas) -> Ground:
    """Where the pixels of a canvas lie on the road plane."""
    right, ahead = seen_ground(canvas)
    return Ground(ahead, ahead, right - canvas.street.middle(ahead), right, ahead)


def paint_streets(canvas: Canvas, at: Random) -> None:
    """Between houses and trees."""
    paint_ground(canvas, place_of(canvas), at)
    for side in (-1.0, 1.0):
        paint_side(canvas, side, at)
    paint_cars(canvas, at)


def paint_tracks(canvas: Canvas, at: Random) -> None:
    """Through fields and woods."""
    paint_track(canvas, place_of(canvas), at)
    paint_bushes(canvas, canvas.street.road_width / 2, at)


def paint_motorways(canvas: Canvas, at: Random) -> None:
    """Wide and fast."""
    paint_motorway(canvas, place_of(canvas), at)
    edge = canvas.street.road_width / 2 + 0.3
    for side in (-1.0, 1.0):
        if at.random() < 0.6:
            paint_barrier(canvas, side * (edge + at.exponential(1.0)), at)
    if at.random() < 0.6:
        paint_bushes(canvas, edge + 3, at)
    for _ in range(int(at.integers(0, 4))):
        paint_lorry(canvas, at)
    paint_cars(canvas, at)


def paint_yards(canvas: Canvas, at: Random) -> None:
    """Crowded streets without kerbs, earth or asphalt between houses."""
    paint_track(canvas, place_of(canvas), at)
    for side in (-1.0, 1.0):
        if at.random() < 0.75:
            paint_side(canvas, side, at)
        else:
            paint_bushes(canvas, canvas.street.road_width / 2 + canvas.street.pavement, at)
    for _ in range(int(at.integers(0, 5))):
        paint_lorry(canvas, at)
    paint_cars(canvas, at)


class Kind(NamedTuple):
    """Who paints it, and from where to where the fields of ``RenderedStreet`` are drawn."""

    paint: Callable[[Canvas, Random], None]
    ranges: Mapping[str, tuple[float, float]]


KINDS: Mapping[str, Kind] = {
    "streets": Kind(paint_streets, {"road_width": (5, 12), "pavement": (0.6, 4), "cars": (0, 7)}),
    "tracks": Kind(
        paint_tracks,
        {"road_width": (1.8, 5), "pavement": (0, 0.3), "offset": (-0.5, 0.5), "dusk": (0, 0.6)},
    ),
    "motorways": Kind(
        paint_motorways,
        {"road_width": (8, 26), "pavement": (0, 1), "offset": (-5, 5), "heading": (-0.06, 0.06)},
    ),
    "yards": Kind(paint_yards, {"road_width": (3.5, 9), "pavement": (0.3, 3), "cars": (0, 7)}),
}


def painted_street(kind: str, at: Random) -> Canvas:
    """A street of a kind on a canvas (480,640), without an ego car."""
    ranges = {"horizon": (0.22, 0.62), **KINDS[kind].ranges}
    street = draw_street(at, **{name: at.uniform(*bounds) for name, bounds in ranges.items()})
    canvas = Canvas(2 * HEIGHT, 2 * WIDTH, street)
    canvas.focal *= at.uniform(0.6, 1.5)
    paint_other_sky(canvas, at)
    paint_horizon(canvas, at)
    KINDS[kind].paint(canvas, at)
    return canvas


def render_street(kind: str, number: int) -> tuple[RenderedScene, Tensor]:
    """One picture (3,240,320) of a kind and its ego car, bool (240,320)."""
    at = np.random.default_rng([sorted(KINDS).index(kind), number])
    canvas = painted_street(kind, at)
    ego = np.zeros(canvas.classes.shape, bool)
    if at.random() < BONNETS:
        ego = paint_ego_car(canvas, at)
    scene = developed(canvas, at)
    return scene, torch.from_numpy(ego[::2, ::2].copy())


# --- the ego car ------------------------------------------------------------------------


def paint_ego_car(canvas: Canvas, at: Random) -> np.ndarray:
    """A bonnet or a dashboard below, bool (H,W): it may mirror the sky and what is ahead."""
    height, width = canvas.height, canvas.width
    x = np.linspace(-1, 1, width)
    aside, bend = at.uniform(-0.5, 0.5), at.uniform(-0.03, 0.16)
    line = at.uniform(0.03, 0.32) - bend * np.abs(x - aside) ** at.uniform(1.5, 4)
    line = np.maximum(line, at.choice([0.0, 0.02]))
    if at.random() < 0.3:  # a dashboard: things stand on it
        for _ in range(int(at.integers(1, 4))):
            middle, half = at.uniform(-1, 1), at.uniform(0.03, 0.3)
            line = line + at.uniform(0, 0.06) / (1 + np.exp((np.abs(x - middle) - half) * 60))
    rows = 1 - (np.arange(height)[:, None] + 0.5) / height
    ego = rows < line
    canvas.rgb[ego] = bonnet_look(canvas, line, rows, at)[ego]
    canvas.classes[ego] = CAR
    return ego


def bonnet_look(canvas: Canvas, line: np.ndarray, rows: np.ndarray, at: Random) -> np.ndarray:
    """Colours (H,W,3) of a bonnet below a line (W,), shares of the height, at rows (H,1)."""
    height, width = canvas.height, canvas.width
    paint = np.clip(at.choice([0.04, 0.08, 0.2, 0.45, 0.8]) + at.normal(0, 0.08, 3), 0.01, 0.95)
    depth = np.clip((line[None] - rows) / max(float(line.max()), 0.05), 0, 1)
    look = paint * (1 + at.uniform(-0.6, 0.8) * depth)[..., None]
    wanted = (
        1 - line[None] - at.uniform(1, 4) * (line[None] - rows)
    ) * height  # mirrored about the edge
    source = np.clip(wanted, 0, height - 1).astype(int)
    mirrored = cv2.GaussianBlur(canvas.rgb, (0, 0), at.uniform(2, 14))[source, np.arange(width)]
    share = at.choice([0.0, 0.15, 0.35, 0.6])
    look = look * (1 - share) + mirrored * share
    sheen = np.exp(-(((line[None] - rows) / at.uniform(0.004, 0.02)) ** 2)) * at.uniform(-0.3, 0.6)
    soft = cv2.resize(cloth(at, octaves=2), (width, height)) * at.uniform(0, 0.15)
    return np.clip(look * (1 + soft)[..., None] + sheen[..., None] * 0.5, 0, 1)


# --- what is written --------------------------------------------------------------------


def truth_of(scene: RenderedScene, ego: Tensor) -> Arrays:
    """What ``prepare_picture`` makes of a picture, with the truth in the teacher's place.

    image: uint8 (3,h,w); maps: uint8 (4,h,w), sky, vertical, horizontal and road as 255ths; ego:
    uint8 (h,w), 255 or 0.
    """
    layout = torch.stack([scene.layout == number for number in range(3)]).float()
    road = (scene.road & ~ego).float()
    small = resized(torch.cat([layout, road[None]]), PREPARED)
    return {
        "image": to_bytes(resized(scene.image, PREPARED).clamp(0, 1)),
        "maps": to_bytes(small.clamp(0, 1)),
        "ego": to_bytes((resized(ego[None].float(), PREPARED)[0] > 0.5).float()),
    }


def write_scene(name: str, scene: RenderedScene, ego: Tensor, pictures: Path, truth: Path) -> None:
    """Write a picture and its truth, as a training run prepares it."""
    write_picture(pictures / name, scene)
    size = torch.tensor((pictures / name).stat().st_size)
    write_arrays(truth / f"{name}.npz", truth_of(scene, ego) | {SOURCE: size})


def write_streets() -> None:
    """Write pictures and truth; those that are there already are kept."""
    parser = argparse.ArgumentParser(description="Write rendered streets of many kinds.")
    parser.add_argument("--count", type=int, default=160, help="pictures of each kind")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--pictures", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True)
    given = parser.parse_args()
    make_folder(given.truth)
    for number in range(given.first, given.first + given.count):
        for kind in KINDS:
            name = f"{kind}_{number:04d}.png"
            if (given.truth / f"{name}.npz").exists():
                continue
            scene, ego = render_street(kind, number)
            write_scene(name, scene, ego, given.pictures, given.truth)


if __name__ == "__main__":
    write_streets()
