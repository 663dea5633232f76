"""A road: its kind, its course over hills, where things on it are, and what is swept along it.

A cross-section is given as (across, up) in metres from the middle of the road.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import cos, pi, sin
from typing import Any, NamedTuple

import numpy as np

from train.worlds.blender import Vector, noise
from train.worlds.plans import Weights
from train.worlds.scene import Material, Point, Scene
from train.worlds.tables import read_table

SPACING = 1.5
"""Metres between the course's points."""

START = 10
"""Index of the point at which the camera is."""

FAR = 85
"""Index from which on (112 metres ahead) the road is void: human labels end somewhere there."""

BEHIND = 22
"""Index ahead of ``START`` at which a camera is that looks backwards."""

END = 130
"""Number of points of a course."""

Section = Sequence[tuple[float, float]]
Limits = tuple[float, float]
Span = tuple[int, int]


class Kind(NamedTuple):
    """A kind of ground, a row of kinds.csv.

    half: half the width of the carriageway in metres, from … to; in towns that of its lanes. bend,
    steepest: limits of its course. ragged: amplitude in metres of its edges. surface, edges, sides:
    kinds of the carriageway, of what adjoins it and of what borders the land, with weights. marks:
    "town", "lanes", "motorway", "bays" or none. trees: from … to. bushes, tufts, people: numbers,
    equally likely. gaps: mean distances between vehicles of a lane, in points of the course; 0 for
    none. parked: probability of parked cars on a side.
    """

    half: Limits
    bend: float
    steepest: float
    ragged: float
    surface: Weights
    edges: Weights
    sides: Weights
    marks: str
    trees: tuple[int, int]
    bushes: Sequence[int]
    tufts: Sequence[int]
    people: Sequence[int]
    gaps: Sequence[int]
    parked: float


KINDS = {row["kind"]: Kind(*list(row.values())[1:]) for row in read_table("kinds")}
NARROW = ("track", "trail", "overgrown", "litter", "lane")
MOTORWAYS = ("motorway", "ramp")


class Course(NamedTuple):
    """The centre line of a road: points (x, y, z), headings in radians, half width in metres."""

    points: list[Any]
    headings: list[float]
    half: float

    def position(self, index: float, across: float, up: float = 0.0) -> Point:
        """Return a position beside the course, at one of its points or between two."""
        first = max(0, min(int(index), END - 2))
        fraction = min(max(index - first, 0.0), 1.0)
        ends = []
        for k in (first, first + 1):
            heading, middle = self.headings[k], self.points[k]
            aside = (across * cos(heading), -across * sin(heading), up)
            ends.append(middle + Vector(aside))
        x, y, z = ends[0].lerp(ends[1], fraction)
        return x, y, z

    def heading(self, index: float) -> float:
        """Return the heading at the nearest point of the course, in radians."""
        return self.headings[max(0, min(round(index), END - 1))]


def sample_course(scene: Scene, half: float, bend: float, steepest: float) -> Course:
    """Sample a gentle curve over gentle hills; bend, steepest: its limits."""
    rng, length = scene.rng, SPACING
    bend *= rng.choice([0.3, 1.0, 1.0])
    first, change = rng.uniform(-0.012, 0.012) * bend, rng.uniform(-0.00022, 0.00022) * bend
    wave = rng.uniform(100, 300)
    steep = rng.choice([0.0, min(0.02, steepest), steepest]) * rng.choice([-1, 1])
    x, y, heading = 0.0, -START * length, 0.0
    points, headings = [], []
    for index in range(END):
        ahead = max(0.0, (index - START) * length)
        points.append(Vector((x, y, steep * wave / 2 / pi * (1 - cos(2 * pi * ahead / wave)))))
        headings.append(heading)
        x, y = x + sin(heading) * length, y + cos(heading) * length
        heading += (first + change * max(index - START, 0)) * length * (index > START)
    return Course(points, headings, half)


@dataclass
class Road:
    """The carriageway, its truth, and the positions of things on it and beside it.

    lanes: (across, direction), the camera's direction being 1; lane: the middle of the camera's,
    where it keeps one; camera: its metres from the middle. gaps: spans in which roads cross. walks:
    by side, where people walk, metres from the middle, and the height of their ground; ends: where
    the land begins; parking: where cars are parked, and at which height. rises: the land's height
    by metres from there. tram: metres from the middle.
    """

    name: str
    kind: Kind
    truth: int
    course: Course
    season: str
    length: int = END
    lane: float | None = None
    camera: float = 0.0
    tram: float | None = None
    lanes: list[tuple[float, int]] = field(default_factory=list)
    gaps: list[Span] = field(default_factory=list)
    walks: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    ends: dict[int, float] = field(default_factory=dict)
    parking: dict[int, tuple[float, float]] = field(default_factory=dict)
    rises: dict[int, Section] = field(default_factory=dict)

    def is_open(self, index: int) -> bool:
        """Return whether no road crosses at a point."""
        return not any(low - 3 <= index <= high + 3 for low, high in self.gaps)

    def land(self, index: int, beyond: float, side: int) -> Point:
        """Return a position on the land, metres from its beginning."""
        near, heights = zip(*self.rises[side], strict=True)
        up = float(np.interp(beyond, near, heights)) - 0.05
        return self.course.position(index, side * (self.ends[side] + beyond), up)


def sweep(
    scene: Scene,
    road: Road,
    section: Section,
    material: Material,
    truth: int,
    span: Span | None = None,
    ragged: float = 0.0,
    bumps: float = 0.0,
) -> None:
    """Sweep a cross-section along a part of the road, or all of it except where roads cross.

    ragged: amplitude in metres of its ends' wandering; bumps: of its height.
    """
    if span is None:
        lows, highs = [low + 1 for low, _ in road.gaps], [high for _, high in road.gaps]
        for part in zip([0, *highs], [*lows, road.length], strict=True):
            sweep(scene, road, section, material, truth, part, ragged, bumps)
        return
    points, uvs = [], []
    count, seed = len(section), scene.rng.uniform(0, 1000)
    for index in range(span[0], min(span[1], END)):
        for k, (across, up) in enumerate(section):
            if ragged and k in (0, count - 1):
                spot = Vector((index * 0.4, seed + 9 * k, 0))
                across += ragged * (1.6 * noise.noise(spot) + scene.rng.uniform(-0.4, 0.4))
            if bumps:
                up += bumps * noise.noise(Vector((index * 0.8, across * 1.3, seed)))
            points.append(road.course.position(index, across, up))
            uvs.append((across, index * SPACING))
    corners = [k for k in range(len(points) - count) if (k + 1) % count]
    faces = [(a, a + 1, a + count + 1, a + count) for a in corners]
    if faces:
        scene.put_surface(points, faces, material, truth, uvs)
