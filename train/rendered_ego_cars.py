"""Rendered streets seen over many ego cars, with their truth: bonnets, dashboards, cockpits.

    python -m train.rendered_ego_cars --count 160 --looks FREE --pictures PICTURES --truth TRUTH

writes as ``train.rendered_streets`` does, whose streets these are. What is new is the car: a
dashboard wide and dark, in bands that follow its edge, with slots, stickers and a telephone; a
strip of bonnet above it; wipers; a pillar at the side; an edge that is neither straight nor
sharp; the colour of the road itself; pieces of real pictures (FREE, without labels), darkened and
blurred, as its surface. A fifth of the pictures shows no car but a band across the near road,
which must not pass for one.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch import read_image
from roadtorch.io.atomic import make_folder
from roadtorch.scenes.canvas import CAR, ROAD, Canvas, RenderedScene, cloth, developed
from train.rendered_streets import KINDS, Random, painted_street, write_scene

NONE = 0.2
"""Share of the pictures without an ego car."""


class Shape(NamedTuple):
    """How an ego car is drawn: ranges as shares of the picture's height.

    tall: of its edge; arch: how much lower the edge is at the sides; strip: of the bonnet above
    a dashboard, 0 for a bonnet alone; bands: how many follow the edge; things: that stand on it.
    """

    tall: tuple[float, float]
    arch: tuple[float, float]
    strip: tuple[float, float]
    bands: tuple[int, int]
    things: tuple[int, int]


SHAPES: Mapping[str, Shape] = {
    "bonnets": Shape((0.03, 0.28), (-0.02, 0.3), (0, 0), (0, 3), (0, 1)),
    "cockpits": Shape((0.14, 0.42), (-0.01, 0.08), (0.01, 0.09), (1, 5), (0, 4)),
    "dashboards": Shape((0.05, 0.34), (-0.03, 0.1), (0, 0.02), (1, 5), (0, 4)),
}


def render_ego_car(
    kind: str, number: int, looks: Sequence[np.ndarray]
) -> tuple[RenderedScene, Tensor]:
    """One picture (3,240,320) with an ego car of a kind, and where it is, bool (240,320).

    looks: real pictures (h,w,3) in [0,1] of which surfaces are cut; may be empty.
    """
    at = np.random.default_rng([7, sorted(SHAPES).index(kind), number])
    canvas = painted_street(str(at.choice(sorted(KINDS))), at)
    ego = np.zeros(canvas.classes.shape, bool)
    if at.random() < NONE:
        paint_band(canvas, at)
    else:
        ego = paint_car(canvas, SHAPES[kind], looks, at)
    return developed(canvas, at), torch.from_numpy(ego[::2, ::2].copy())


def paint_band(canvas: Canvas, at: Random) -> None:
    """A darker, lighter or rougher band across the near road: a joint, a crossing, a shadow."""
    x = np.linspace(-1, 1, canvas.width)
    rows = heights(canvas)
    low = at.uniform(-0.1, 0.2) + at.uniform(-0.05, 0.05) * x
    band = (rows > low) & (rows < low + at.uniform(0.02, 0.2)) & (canvas.classes == ROAD)
    rough = 1 + at.uniform(0, 0.2) * cv2.resize(cloth(at), (canvas.width, canvas.height))
    canvas.rgb[band] *= (at.uniform(0.35, 1.5) * rough)[band][:, None]


def heights(canvas: Canvas) -> np.ndarray:
    """Of each row's middle above the lower edge, shares of the height (H,1)."""
    return 1 - (np.arange(canvas.height)[:, None] + 0.5) / canvas.height


# --- the edge ---------------------------------------------------------------------------


def drawn_edge(width: int, shape: Shape, at: Random) -> np.ndarray:
    """Where an ego car ends above, shares of the height (width,): arched, tilted, uneven."""
    x = np.linspace(-1, 1, width)
    arch = at.uniform(*shape.arch) * np.abs(x - at.uniform(-0.6, 0.6)) ** at.uniform(1.5, 4)
    uneven = cv2.resize(cloth(at, octaves=1)[:1], (width, 1), interpolation=cv2.INTER_CUBIC)[0]
    edge = at.uniform(*shape.tall) - arch + at.uniform(-0.025, 0.025) * x
    edge = edge + at.choice([0.0, 0.002, 0.006]) * uneven
    for _ in range(int(at.integers(*shape.things, endpoint=True))):
        edge = np.maximum(edge, thing(x, edge, at))
    return np.maximum(edge, at.choice([0.0, 0.015]))


def thing(x: np.ndarray, edge: np.ndarray, at: Random) -> np.ndarray:
    """The edge with a telephone, a holder or a hood upon it: a box with round corners."""
    middle, half = at.uniform(-1.1, 1.1), at.uniform(0.03, 0.4)
    steep = at.choice([15.0, 60.0])
    return edge + at.uniform(0.005, 0.16) / (1 + np.exp((np.abs(x - middle) - half) * steep))


# --- the surface ------------------------------------------------------------------------


def paint_car(canvas: Canvas, shape: Shape, looks: Sequence[np.ndarray], at: Random) -> np.ndarray:
    """Paint an ego car of a shape; where it is, bool (H,W)."""
    rows, edge = heights(canvas), drawn_edge(canvas.width, shape, at)
    scene = canvas.rgb.copy()
    look = surface(canvas, scene, rows, edge, looks, at)
    smooth = cv2.GaussianBlur(edge[None], (0, 0), at.uniform(20, 90))[0]
    below = np.minimum(edge, smooth) - at.uniform(*shape.strip)
    for number in range(int(at.integers(*shape.bands, endpoint=True))):
        part = rows < below
        look = np.where(part[..., None], surface(canvas, scene, rows, below, looks, at), look)
        share = at.uniform(0.05, 0.5) if number else at.uniform(0.02, 0.3)
        x = np.linspace(-1, 1, canvas.width)
        below = below - share * np.maximum(edge, 0) - at.uniform(-0.01, 0.01) * np.abs(x) ** 2
    ego = rows < edge
    if at.random() < 0.15:
        ego = ego | pillar(canvas, at)
    look = with_details(look, rows, edge, at)
    soft = cv2.GaussianBlur(ego.astype(np.float32), (0, 0), at.uniform(0.3, 5))[..., None]
    canvas.rgb[:] = (scene + haze(rows, edge, at)) * (1 - soft) + look * soft
    wipers(canvas, edge, at)
    canvas.classes[ego] = CAR
    return ego


def surface(
    canvas: Canvas,
    scene: np.ndarray,
    rows: np.ndarray,
    edge: np.ndarray,
    looks: Sequence[np.ndarray],
    at: Random,
) -> np.ndarray:
    """Colours (H,W,3) of one band of a car below an edge (W,): paint, plastic or a mirror."""
    depth = np.clip((edge[None] - rows) / max(float(edge.max()), 0.05), 0, 1)[..., None]
    colour = drawn_tone(canvas, scene, at) * (1 + at.uniform(-0.7, 1.0) * depth)
    across = cv2.resize(
        cloth(at, octaves=4)[: int(at.integers(4, 200))], (canvas.width, canvas.height)
    )
    colour = colour * (1 + at.choice([0.02, 0.1, 0.25]) * across)[..., None]
    mirrored = mirror(scene, rows, edge, at)
    colour = colour + at.choice([0.0, 0.05, 0.2, 0.6], p=[0.4, 0.2, 0.25, 0.15]) * (
        mirrored - colour
    )
    if looks and at.random() < 0.3:
        piece = cut_piece(looks, canvas, at)
        colour = colour + at.uniform(0.2, 0.9) * (piece * at.uniform(0.1, 0.9) - colour)
    sheen = np.exp(-(((edge[None] - rows) / at.uniform(0.003, 0.03)) ** 2))[..., None]
    return np.clip(colour + at.uniform(-0.2, 0.25) * sheen, 0, 1)


def drawn_tone(canvas: Canvas, scene: np.ndarray, at: Random) -> np.ndarray:
    """A colour (3,): mostly dark, at times grey, light or that of the road before it."""
    road = canvas.classes == ROAD
    if at.random() < 0.3 and road.any():
        return scene[road].mean(0) * at.uniform(0.5, 1.5)
    tone = at.choice([0.02, 0.06, 0.12, 0.3, 0.7], p=[0.25, 0.25, 0.2, 0.2, 0.1])
    return np.clip(tone * np.exp(at.normal(0, 0.4) + at.normal(0, 0.15, 3)), 0.005, 0.95)


def mirror(scene: np.ndarray, rows: np.ndarray, edge: np.ndarray, at: Random) -> np.ndarray:
    """The scene (H,W,3) upside down below an edge (W,), blurred and stretched."""
    height, width = scene.shape[:2]
    wanted = (1 - edge[None] - at.uniform(1, 6) * (edge[None] - rows)) * height
    source = np.clip(wanted, 0, height - 1).astype(int)
    return cv2.GaussianBlur(scene, (0, 0), at.uniform(2, 20))[source, np.arange(width)]


def cut_piece(looks: Sequence[np.ndarray], canvas: Canvas, at: Random) -> np.ndarray:
    """A piece of a real picture, blurred and as large as the canvas (H,W,3)."""
    look = looks[int(at.integers(len(looks)))]
    height, width = look.shape[:2]
    tall, wide = (int(side * at.uniform(0.15, 0.6)) for side in (height, width))
    top, left = (int(at.integers(whole - part)) for whole, part in ((height, tall), (width, wide)))
    piece = cv2.resize(look[top : top + tall, left : left + wide], (canvas.width, canvas.height))
    return cv2.GaussianBlur(piece, (0, 0), at.uniform(1, 12))


# --- details ----------------------------------------------------------------------------


def with_details(look: np.ndarray, rows: np.ndarray, edge: np.ndarray, at: Random) -> np.ndarray:
    """A car's look (H,W,3) with slots along it, stickers and lamps upon it."""
    height, width = look.shape[:2]
    look = look.copy()
    if at.random() < 0.3:  # a row of slots
        middle, dots = edge * at.uniform(0.2, 0.8), np.arange(width) % at.integers(6, 14) < 3
        look[(np.abs(rows - middle[None]) < at.uniform(0.004, 0.012)) & dots[None]] *= 0.4
    for _ in range(int(at.choice([0, 0, 0, 1, 2, 3]))):
        place = (at.uniform(0, width), height * (1 - at.uniform(0, max(float(edge.max()), 0.02))))
        size = (width * at.uniform(0.01, 0.12), height * at.uniform(0.008, 0.07))
        box = cv2.boxPoints((place, size, at.uniform(-30, 30)))
        tone = at.choice([0.03, 0.5, 0.9]) * np.exp(at.normal(0, 0.3, 3))
        cv2.fillPoly(look, [np.round(box).astype(np.int32)], np.clip(tone, 0, 1).tolist())
    return look


def haze(rows: np.ndarray, edge: np.ndarray, at: Random) -> np.ndarray:
    """What the windscreen mirrors of the dashboard, light (H,W,1) added above an edge (W,)."""
    if at.random() < 0.6:
        return np.zeros((len(rows), len(edge), 1))
    fade = np.exp(-np.clip(rows - edge[None], 0, 1) / at.uniform(0.05, 0.5))
    return at.uniform(0, 0.25) * fade[..., None]


def pillar(canvas: Canvas, at: Random) -> np.ndarray:
    """A pillar beside the windscreen, bool (H,W), from the lower corner up."""
    side = at.integers(2)
    foot, lean, tall = at.uniform(0.02, 0.25), at.uniform(0.1, 0.6), at.uniform(0.4, 1.2)
    rows, x = heights(canvas), np.linspace(0, 1, canvas.width)
    aside = x if side else 1 - x
    return (aside[None] < foot - lean * foot * rows) & (rows < tall)


def wipers(canvas: Canvas, edge: np.ndarray, at: Random) -> None:
    """Dark thin arcs at the windscreen's foot: no ego car, too thin for the truth."""
    for _ in range(int(at.choice([0, 0, 1, 2]))):
        foot = at.uniform(0, 1)
        row = canvas.height * (1 - float(edge[int(foot * (canvas.width - 1))]))
        tip = (foot + at.uniform(-0.5, 0.5), row - canvas.height * at.uniform(-0.01, 0.06))
        first, last = ((int(x * canvas.width), int(y)) for x, y in ((foot, row), tip))
        thick = int(at.integers(2, 7))
        cv2.line(canvas.rgb, first, last, (0.04, 0.04, 0.04), thick, cv2.LINE_AA)


# --- what is written --------------------------------------------------------------------


def read_looks(folder: Path) -> list[np.ndarray]:
    """The pictures of a folder, (h,w,3) in [0,1]."""
    found = sorted(folder.glob("*.jpg"))
    return [np.ascontiguousarray(read_image(path).permute(1, 2, 0).numpy()) for path in found]


def main() -> None:
    parser = argparse.ArgumentParser(description="Write rendered streets over many ego cars.")
    parser.add_argument("--count", type=int, default=160, help="pictures of each kind")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--looks", type=Path, required=True, help="folder of real pictures")
    parser.add_argument("--pictures", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True)
    given = parser.parse_args()
    make_folder(given.truth)
    looks = read_looks(given.looks)
    for number in range(given.first, given.first + given.count):
        for kind in SHAPES:
            name = f"{kind}_{number:04d}.png"
            if not (given.truth / f"{name}.npz").exists():
                scene, ego = render_ego_car(kind, number, looks)
                write_scene(name, scene, ego, given.pictures, given.truth)


if __name__ == "__main__":
    main()
