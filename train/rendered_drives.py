"""Rendered drives with exact truth: the camera follows a road that goes straight, bends, goes on.

Everything has its place in the world (metres; x to the right, y ahead of where the road begins):
the texture of the ground, lane marks, shadows, houses, trees, parked cars. One car drives ahead.
The camera sways a little, the light wavers, and the sensor's noise is new in every frame.

``python train/rendered_drives.py --out DIR --seed 0`` writes frames to look at.
"""

import argparse
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from roadtorch.scenes.canvas import (
    BUILDING,
    TREE,
    Canvas,
    RenderedScene,
    RenderedStreet,
    developed,
    draw_street,
    seen_ground,
)
from roadtorch.scenes.street import FAR, Ground, paint_car, paint_ground, paint_sky, write_picture

NEAREST = 0.6  # metres: what is closer to the camera is cut off
AGAIN = 42.0  # metres after which shadows repeat; lane marks and joints fit into it
NOWHERE = 1e3  # metres beside the road: behind the middle of the bend's circle
SWAY_MEMORY = 0.85  # of sway and light from frame to frame
HOUSES = [(0.62, 0.42, 0.34), (0.78, 0.74, 0.66), (0.55, 0.5, 0.45), (0.7, 0.66, 0.62)]


@dataclass(frozen=True)
class Bend:
    """A road's middle line: straight, an arc of a circle, straight. Metres and radians.

    before: length of the first straight. angle: of the arc; to the right if side is 1, to the
    left if it is -1.
    """

    before: float
    radius: float
    angle: float
    side: float

    def at(self, along: float) -> tuple[np.ndarray, float]:
        """Place (x, y) of the middle at a length, and the heading there, to the right of y."""
        turned = min(max((along - self.before) / self.radius, 0.0), self.angle)
        x, y = self.radius * (1 - math.cos(turned)), self.radius * math.sin(turned)
        rest = along - self.before - self.radius * turned
        x, y = x + rest * math.sin(turned), y + self.before + rest * math.cos(turned)
        return np.array([self.side * x, y]), self.side * turned

    def beside(self, along: float, across: float) -> np.ndarray:
        """Place (x, y) so far to the right of the middle at a length."""
        place, heading = self.at(along)
        return place + across * np.array([math.cos(heading), -math.sin(heading)])

    def lengths(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Metres along the middle and across it, to its right, of places of one shape."""
        x = self.side * x
        pieces = [(y, x, y <= self.before)]
        inward, forward = self.radius - x, y - self.before
        turned = np.arctan2(forward, inward)
        arc = (turned >= 0) & (turned <= self.angle)
        pieces.append(
            (self.before + self.radius * turned, self.radius - np.hypot(inward, forward), arc)
        )
        end, heading = self.at(self.before + self.radius * self.angle)
        east, north = x - self.side * end[0], y - end[1]
        sine, cosine = math.sin(self.side * heading), math.cos(heading)
        rest = east * sine + north * cosine
        pieces.append(
            (self.before + self.radius * self.angle + rest, east * cosine - north * sine, rest >= 0)
        )
        along, across = np.zeros_like(x), np.full_like(x, NOWHERE)
        for length, off, there in pieces:
            nearer = there & (np.abs(off) < np.abs(across))
            along, across = np.where(nearer, length, along), np.where(nearer, off, across)
        return along, self.side * across


class DriveView(NamedTuple):
    """A canvas and where its camera stands in the world: (x, y), heading to the right of y."""

    canvas: Canvas
    place: np.ndarray
    heading: float

    def seen(self, points: np.ndarray) -> np.ndarray:
        """World points (n,3) as metres right, up, ahead of the camera's foot (n,3)."""
        east, north = (points[:, :2] - self.place).T
        sine, cosine = math.sin(self.heading), math.cos(self.heading)
        right, ahead = east * cosine - north * sine, east * sine + north * cosine
        return np.stack([right, points[:, 2], ahead], 1)

    def polygon(self, points: np.ndarray, colour: np.ndarray, kind: int) -> None:
        """Fill a flat polygon of world points (n,3), as far as it is before the camera."""
        inside = before_camera(self.seen(points))
        if len(inside) > 2:
            self.canvas.polygon((self.canvas.project(*point) for point in inside), colour, kind)


def before_camera(points: np.ndarray) -> np.ndarray:
    """A polygon (n,3) of right, up, ahead without what is behind ``NEAREST`` (m,3).

    Sutherland and Hodgman, Reentrant polygon clipping, CACM 17(1), 1974, with one plane.
    """
    kept = []
    for here, there in zip(points, np.roll(points, -1, 0), strict=True):
        if here[2] >= NEAREST:
            kept.append(here)
        if (here[2] >= NEAREST) != (there[2] >= NEAREST):
            kept.append(here + (there - here) * (NEAREST - here[2]) / (there[2] - here[2]))
    return np.array(kept)


# --- what stands beside the road --------------------------------------------------------


class Upright(Protocol):
    """Something that stands on the ground."""

    def where(self, seconds: float) -> np.ndarray:
        """Its place (x, y)."""
        ...

    def paint(self, view: DriveView, seconds: float) -> None:
        """Paint it as it stands there then."""
        ...


@dataclass(frozen=True)
class House:
    """Four walls over corners (4,2), the first two along the street."""

    corners: np.ndarray
    height: float
    colour: np.ndarray

    def where(self, seconds: float) -> np.ndarray:
        """Its middle."""
        return self.corners.mean(0)

    def paint(self, view: DriveView, seconds: float) -> None:
        """Walls, the farthest first; the one along the street has windows."""
        sides = [(self.corners[i], self.corners[(i + 1) % 4], i) for i in range(4)]
        sides.sort(key=lambda side: -math.dist((side[0] + side[1]) / 2, view.place))
        for begin, end, number in sides:
            light = (1.0, 0.8, 0.7, 0.86)[number]
            view.polygon(wall(begin, end, 0.0, self.height), self.colour * light, BUILDING)
            if number == 0:
                self._paint_windows(view, begin, end)

    def _paint_windows(self, view: DriveView, begin: np.ndarray, end: np.ndarray) -> None:
        glass, length = np.array([0.2, 0.24, 0.3]), math.dist(begin, end)
        for floor in np.arange(1.0, self.height - 1.6, 2.7):
            for left in np.arange(0.8, length - 1.2, 2.2):
                one, other = (begin + (end - begin) * at / length for at in (left, left + 1.1))
                view.polygon(wall(one, other, floor, floor + 1.4), glass, BUILDING)


def wall(begin: np.ndarray, end: np.ndarray, low: float, high: float) -> np.ndarray:
    """The corners (4,3) of an upright rectangle over a line."""
    return np.array([[*begin, low], [*end, low], [*end, high], [*begin, high]])


@dataclass(frozen=True)
class StreetTree:
    """A trunk under discs of leaves (n,5): right, up, radius, and light, that face the camera."""

    foot: np.ndarray
    leaves: np.ndarray

    def where(self, seconds: float) -> np.ndarray:
        """Its foot."""
        return self.foot

    def paint(self, view: DriveView, seconds: float) -> None:
        """The trunk, then the leaves."""
        ((right, _, ahead),) = view.seen(np.array([[*self.foot, 0.0]]))
        if ahead < 2:
            return
        corners = [(-0.15, 0), (0.15, 0), (0.12, 3), (-0.12, 3)]
        trunk = [view.canvas.project(right + dx, up, ahead) for dx, up in corners]
        view.canvas.polygon(trunk, np.array([0.27, 0.2, 0.14]), TREE)
        turn = np.linspace(0, 2 * np.pi, 13)[:-1]
        for dx, up, radius, light in self.leaves:
            ring = zip(right + dx + radius * np.cos(turn), up + radius * np.sin(turn), strict=True)
            points = [view.canvas.project(x, y, ahead) for x, y in ring]
            view.canvas.polygon(points, np.array([0.22, 0.34, 0.13]) * light, TREE)


@dataclass(frozen=True)
class Car:
    """A car seen from behind. along, across: its place on the road at first. speed: metres/s."""

    bend: Bend
    along: float
    across: float
    speed: float
    seed: int

    def where(self, seconds: float) -> np.ndarray:
        """The middle of its back."""
        return self.bend.beside(self.along + self.speed * seconds, self.across)

    def paint(self, view: DriveView, seconds: float) -> None:
        """As in a still scene: it always shows its back."""
        ((right, _, ahead),) = view.seen(np.array([[*self.where(seconds), 0.0]]))
        if 3 < ahead < FAR:
            paint_car(view.canvas, right, ahead, np.random.default_rng(self.seed))


def furnished(
    street: RenderedStreet, bend: Bend, length: float, generator: np.random.Generator
) -> list[Upright]:
    """Houses, trees and cars along so many metres of the road."""
    found: list[Upright] = []
    gap = street.road_width / 2 + street.pavement
    for side in (-1.0, 1.0):
        along = -5.0
        while along < length:
            depth, back = generator.uniform(5, 13), gap + generator.uniform(0.4, 3)
            house = draw_house(bend, (along, along + depth), side * back, generator)
            free = np.abs(bend.lengths(*house.corners.T)[1]).min() > gap
            if free and generator.random() < 0.68:
                found.append(house)
            else:
                found.append(
                    draw_tree(bend.beside(along + depth / 2, side * (gap + 0.6)), generator)
                )
            along += depth * generator.uniform(1.0, 1.2)
    half = street.road_width / 2
    for _ in range(int(street.cars)):
        side, place = generator.choice([-1.0, 1.0]), generator.uniform(15, length)
        found.append(Car(bend, place, side * half, 0.0, int(generator.integers(1000))))
    lead, speed = generator.uniform(14, 25), generator.uniform(7, 12)
    found.append(Car(bend, lead, street.offset, speed, int(generator.integers(1000))))
    return found


def draw_house(
    bend: Bend, span: tuple[float, float], across: float, generator: np.random.Generator
) -> House:
    """A house along the road over a span of its length, its street wall so far from the middle."""
    begin, end = (bend.beside(along, across) for along in span)
    street = end - begin
    outwards = np.array([street[1], -street[0]]) * np.sign(across) / np.linalg.norm(street)
    depth = generator.uniform(6, 12)
    corners = np.stack([begin, end, end + depth * outwards, begin + depth * outwards])
    colour = np.array(HOUSES[generator.integers(len(HOUSES))]) * generator.uniform(0.75, 1.1)
    return House(corners, generator.uniform(4, 12), colour)


def draw_tree(foot: np.ndarray, generator: np.random.Generator) -> StreetTree:
    """A tree with leaves of several greens."""
    leaves = [
        (
            generator.normal(0, 0.9),
            4 + generator.normal(0, 0.8),
            radius,
            generator.uniform(0.6, 1.3),
        )
        for radius in generator.uniform(0.5, 1.4, 12)
    ]
    return StreetTree(foot, np.array(leaves))


# --- the drive --------------------------------------------------------------------------


def render_drive(
    seed: int,
    frames: int = 60,
    height: int = 270,
    width: int = 480,
    rate: float = 15.0,
    **options: float,
) -> Iterator[RenderedScene]:
    """The drive of a seed, frame by frame; any field of RenderedStreet can be fixed by name.

    rate: frames a second. Every frame has its exact truth.
    """
    parts = np.random.default_rng(seed).spawn(5)
    street = draw_street(parts[0], **{"shadows": 2, "cars": 2, **options})
    bend = Bend(*(parts[1].uniform(*span) for span in ((10, 22), (18, 40), (0.5, 1.2))), side=1.0)
    bend = replace(bend, side=float(parts[1].choice([-1.0, 1.0])))
    speed = parts[1].uniform(7, 12)
    uprights = furnished(street, bend, frames / rate * speed + FAR, parts[2])
    wavers = wavering(frames, parts[3])
    looks = [int(each) for each in parts[4].integers(2**31, size=2)]
    for number, (sway, pitch, light) in enumerate(wavers):
        seconds = number / rate
        middle, heading = bend.at(speed * seconds)
        side = np.array([math.cos(heading), -math.sin(heading)])
        tilted = replace(street, horizon=street.horizon + 0.004 * pitch)
        view = DriveView(
            Canvas(2 * height, 2 * width, tilted),
            middle + street.offset * side,
            heading + 0.006 * sway,
        )
        paint_view(view, bend, uprights, seconds, looks)
        view.canvas.rgb *= math.exp(0.05 * light)
        yield developed(view.canvas, np.random.default_rng([seed, number]))


def wavering(frames: int, generator: np.random.Generator) -> np.ndarray:
    """Three slow noises (frames,3), each about a standard deviation of 1."""
    found = generator.standard_normal((frames, 3))
    for number in range(1, frames):
        fresh = math.sqrt(1 - SWAY_MEMORY**2) * found[number]
        found[number] = SWAY_MEMORY * found[number - 1] + fresh
    return found


def paint_view(
    view: DriveView, bend: Bend, uprights: Iterable[Upright], seconds: float, looks: list[int]
) -> None:
    """Sky, ground and what stands on it, the farthest first; looks: seeds of sky and ground."""
    canvas = view.canvas
    paint_sky(canvas, np.random.default_rng(looks[0]))
    canvas.rgb[:] = np.roll(canvas.rgb, -round(canvas.focal * view.heading), 1)
    right, ahead = seen_ground(canvas)
    sine, cosine = math.sin(view.heading), math.cos(view.heading)
    x = view.place[0] + right * cosine + ahead * sine
    y = view.place[1] - right * sine + ahead * cosine
    along, across = bend.lengths(x, y)
    place = Ground(ahead, along % AGAIN, across, x, y)
    paint_ground(canvas, place, np.random.default_rng(looks[1]))
    far_first = sorted(uprights, key=lambda one: -math.dist(one.where(seconds), view.place))
    for one in far_first:
        if math.dist(one.where(seconds), view.place) < FAR:
            one.paint(view, seconds)


def write_drive() -> None:
    """Write the frames of a drive as PNG files."""
    parser = argparse.ArgumentParser(description="Write the frames of a rendered drive as PNG.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=60)
    given = parser.parse_args()
    for number, frame in enumerate(render_drive(given.seed, given.frames)):
        write_picture(given.out / f"drive{given.seed:02d}_{number:03d}.png", frame)


if __name__ == "__main__":
    write_drive()
