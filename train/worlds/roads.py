"""The road: its course over hills, its surface, what bounds it, the land beside it.

A cross-section is given as (across, up) in metres from the road's middle and swept along the
course; the land is swept as well, so that everything follows the hills.
"""
# pyright: reportMissingImports=false
# (Blender is in an environment of its own)

from collections.abc import Sequence
from itertools import pairwise
from math import cos, pi, sin
from typing import NamedTuple

import bpy
from mathutils import Vector, noise

from train.worlds.materials import Colour, drawn, ground, paved, plain
from train.worlds.stage import HORIZONTAL, ROAD, VERTICAL, VOID, Material, Stage

SPACING = 1.5
"""Metres between the course's points."""

START = 10
"""The point at which the camera stands."""

FAR = 85
"""From this point on (112 metres ahead) the road is void: people's labels end somewhere there."""

Section = Sequence[tuple[float, float]]

KINDS = {
    "street": 5,
    "rural": 4,
    "motorway": 2,
    "track": 5,
    "trail": 3,
    "overgrown": 10,
    "yard": 2,
    "bazaar": 3,
    "lane": 2,
}
"""Kinds of road, and how often each is drawn."""

UNPAVED = ("track", "trail", "overgrown")
"""The last is a trail with grass on it between tall grass and bushes."""

EARTHS = [
    (0.32, 0.24, 0.16),
    (0.4, 0.36, 0.3),
    (0.2, 0.16, 0.12),
    (0.3, 0.3, 0.29),
    (0.5, 0.47, 0.42),
    (0.4, 0.2, 0.11),
]
GREENS = [
    (0.1, 0.17, 0.05),
    (0.16, 0.2, 0.07),
    (0.3, 0.26, 0.13),
    (0.07, 0.11, 0.04),
    (0.38, 0.33, 0.2),
]
LITTER = [(0.2, 0.13, 0.07), (0.28, 0.2, 0.12), (0.15, 0.12, 0.08), (0.35, 0.3, 0.25)]
SNOW = [(0.75, 0.78, 0.84), (0.6, 0.62, 0.66)]
PAVINGS = [
    (0.4, 0.38, 0.35),
    (0.28, 0.28, 0.28),
    (0.4, 0.3, 0.24),
    (0.18, 0.18, 0.18),
    (0.5, 0.49, 0.46),
]


class Course(NamedTuple):
    """The middle of the road: points (x, y, z), headings in radians, half its width in metres."""

    points: list[Vector]
    headings: list[float]
    half: float

    def at(self, index: int, across: float, up: float = 0.0) -> tuple[float, float, float]:
        """Where a point beside the course is."""
        heading, middle = self.headings[index], self.points[index]
        return (middle.x + across * cos(heading), middle.y - across * sin(heading), middle.z + up)


class Road(NamedTuple):
    """What the other parts need to know: land is where the land begins, from the middle."""

    kind: str
    course: Course
    land: float
    season: str
    gaps: list[tuple[int, int]]
    length: int
    land_rises: dict[int, Section]

    def open(self, index: int) -> bool:
        """Whether nothing crosses here."""
        return not any(low - 3 <= index <= high + 3 for low, high in self.gaps)

    def spot(self, index: int, beyond: float, side: int) -> tuple[float, float, float]:
        """A place on the land, metres beyond where it begins."""
        rises = self.land_rises[side]
        for (near, low), (far, high) in pairwise(rises):
            if near <= beyond <= far:
                up = low + (high - low) * (beyond - near) / (far - near)
                break
        else:
            up = rises[-1][1]
        return self.course.at(index, side * (self.land + beyond), up - 0.05)


def drawn_course(stage: Stage, kind: str) -> Course:
    """A gentle curve over gentle hills, narrower or wider by kind."""
    at = stage.at
    widths = {"street": (2.8, 6.5), "rural": (2.2, 3.8), "motorway": (5.5, 9), "track": (1.2, 2.3)}
    widths |= {
        "trail": (1.2, 2.6),
        "overgrown": (1.3, 3.0),
        "yard": (7, 20),
        "bazaar": (2.5, 6),
        "lane": (1.6, 2.6),
    }
    bend = {"motorway": 0.3, "yard": 0.0}.get(kind, 1.0) * at.choice([0.3, 1.0, 1.0])
    first, change = at.uniform(-0.012, 0.012) * bend, at.uniform(-0.00022, 0.00022) * bend
    wave, length = at.uniform(100, 300), SPACING
    steepest = {"trail": 0.14, "overgrown": 0.25, "yard": 0.0}.get(kind, 0.07)
    steep = at.choice([0.0, min(0.02, steepest), steepest]) * at.choice([-1, 1])
    x, y, heading = 0.0, -START * length, 0.0
    points, headings = [], []
    for index in range(130):
        ahead = max(0.0, (index - START) * length)
        z = steep * wave / 2 / pi * (1 - cos(2 * pi * ahead / wave))
        points.append(Vector((x, y, z)))
        headings.append(heading)
        x, y = x + sin(heading) * length, y + cos(heading) * length
        heading += (first + change * max(index - START, 0)) * length * (index > START)
    return Course(points, headings, at.uniform(*widths[kind]))


def swept(
    stage: Stage,
    course: Course,
    section: Section,
    material: Material,
    truth: int,
    ragged: float = 0.0,
    span: tuple[int, int] = (0, 130),
    bumps: float = 0.0,
) -> None:
    """Sweep a cross-section along a part of the course.

    ragged: metres by which its ends wander; bumps: metres by which it goes up and down.
    """
    points, faces, uvs = [], [], []
    count = len(section)
    seed = stage.at.uniform(0, 1000)
    for index in range(max(span[0], 0), min(span[1], len(course.points))):
        for k, (across, up) in enumerate(section):
            if ragged and k in (0, count - 1):
                spot = Vector((index * 0.4, seed + 9 * k, 0))
                across += ragged * (1.6 * noise.noise(spot) + stage.at.uniform(-0.4, 0.4))
            if bumps:
                up += bumps * noise.noise(Vector((index * 0.8, across * 1.3, seed)))
            points.append(course.at(index, across, up))
            uvs.append((across, index * SPACING))
    for row in range(len(points) // count - 1):
        for k in range(count - 1):
            a = row * count + k
            faces.append((a, a + 1, a + count + 1, a + count))
    if not faces:
        return
    mesh = bpy.data.meshes.new("swept")
    mesh.from_pydata(points, [], faces)
    mesh.materials.append(material)
    layer = mesh.uv_layers.new(name="UV")
    layer.data.foreach_set("uv", [value for face in faces for k in face for value in uvs[k]])
    stage.put(mesh, truth)


def swept_between(
    stage: Stage, road: Road, section: Section, material: Material, truth: int
) -> None:
    """The same but for where another road crosses."""
    first = 0
    for low, high in [*road.gaps, (road.length, road.length)]:
        swept(stage, road.course, section, material, truth, span=(first, low + 1))
        first = high


# --- the whole --------------------------------------------------------------------------


def build_road(stage: Stage, kind: str, season: str) -> Road:
    """Road, bounds, marks and land of one world."""
    at = stage.at
    course = drawn_course(stage, kind)
    crossing = kind in ("street", "bazaar", "rural") and stage.chance(0.4)
    where = at.randint(START + 6, START + 26)
    gaps = [(where, where + at.randint(4, 7))] if crossing else []
    length = at.randint(START + 12, START + 45) if kind == "yard" else 130
    road = Road(kind, course, course.half, season, gaps, length, {})
    surface, soil = _surface(stage, road), _soil(stage, season, kind)
    ragged = {"rural": 0.07, "bazaar": 0.3, "lane": 0.1} | dict.fromkeys(UNPAVED, 0.3)
    ragged, bumps = ragged.get(kind, 0.0), 0.04 * (kind in UNPAVED)
    flat = [(course.half * (k / 4 - 1), 0.03) for k in range(9)]
    swept(stage, course, flat, surface, ROAD, ragged, (0, min(FAR, length)), bumps)
    swept(stage, course, flat, surface, VOID, 0.0, (FAR - 1, length), bumps)
    if gaps:
        _cross(stage, road, surface)
    if kind in ("track", "trail", "lane") and stage.chance({"track": 0.55}.get(kind, 0.15)):
        wide = at.uniform(0.15, 0.4)
        truth = HORIZONTAL if wide > 0.22 else VOID
        swept(stage, course, [(-wide, 0.06), (0, 0.1), (wide, 0.06)], soil, truth, 0.15)
    road = road._replace(land=_bound(stage, road, surface, soil))
    if kind not in (*UNPAVED, "yard", "lane"):
        _mark(stage, road)
    if kind == "yard":
        _mark_bays(stage, road)
    if kind == "street" and stage.chance(0.2):
        _rails(stage, road)
    _land(stage, road, soil)
    return road


def _surface(stage: Stage, road: Road) -> Material:
    """Asphalt, concrete, cobbles, gravel or earth; wet or under snow at times."""
    at = stage.at
    wet = at.uniform(0.2, 1) if stage.chance(0.22) else 0.0
    slush = drawn(stage, SNOW) if road.season == "snow" and stage.chance(0.75) else None
    if road.kind == "overgrown" and stage.chance(0.6):
        return _soil(stage, road.season, road.kind)
    loose = road.kind in UNPAVED or (road.kind in ("yard", "lane", "bazaar") and stage.chance(0.35))
    if loose:
        colours = EARTHS if road.kind == "track" else LITTER + EARTHS
        colour = drawn(stage, colours, 0.35)
        ruts = at.uniform(-0.25, 0.4)
        edge = drawn(stage, GREENS + LITTER) if stage.chance(0.5) else None
        return paved(
            stage, colour, road.course.half, wet, at.choice([0.0, 0.0, 0.06]), slush, ruts, edge
        )
    tone = at.uniform(0.04, 0.34)
    colour = tuple(tone * at.uniform(0.96, 1.04) for _ in range(3))
    stones = at.uniform(0.1, 0.25) if road.kind in ("street", "lane") and stage.chance(0.2) else 0.0
    return paved(stage, colour, road.course.half, wet, stones, slush, at.uniform(-0.12, 0.2))


def _soil(stage: Stage, season: str, kind: str) -> Material:
    """What the land beside is made of."""
    at = stage.at
    colours = {"snow": SNOW, "earth": EARTHS, "litter": LITTER, "dry": GREENS[2:3] + GREENS[4:]}
    mine: Sequence[Colour] = colours.get(season, GREENS)
    second = mine if stage.chance(0.6) or season == "snow" else EARTHS + LITTER
    grain = at.uniform(1, 12)
    return ground(stage, drawn(stage, mine), drawn(stage, second), grain, at.uniform(0.15, 0.6))


def _bound(stage: Stage, road: Road, surface: Material, soil: Material) -> float:
    """Kerbs and pavements, shoulders and rails, dust beside; where the land begins."""
    at, half = stage.at, road.course.half
    if road.kind == "street":
        wide, high = at.uniform(1.2, 4.5), at.uniform(0.07, 0.18)
        # a pavement of the road's own colour, which a kerb alone parts from it, is not rare
        paving = (
            surface
            if stage.chance(0.25)
            else paved(stage, drawn(stage, PAVINGS), 99, stones=at.choice([0.0, 0.0, 0.3, 0.5]))
        )
        kerb = plain(stage, drawn(stage, PAVINGS), 0.9)
        for side in (-1, 1):
            if stage.chance(0.9):
                edge = [
                    (side * half, 0.0),
                    (side * half, high),
                    (side * (half + 0.14), high + 0.01),
                ]
                swept_between(stage, road, edge, kerb, HORIZONTAL)
                walk = [(side * (half + 0.14), high), (side * (half + wide), high + 0.02)]
                swept_between(stage, road, walk, paving, HORIZONTAL)
        return half + wide
    if road.kind == "motorway":
        metal = plain(stage, drawn(stage, [(0.45, 0.45, 0.47), (0.5, 0.49, 0.46)]), 0.5)
        for side in (-1, 1):
            if stage.chance(0.75):
                out = side * (half + at.uniform(0.4, 1.5))
                low = at.choice([0.0, 0.5])
                swept(
                    stage,
                    road.course,
                    [(out, low), (out, 0.8), (out + 0.2 * side, 0.8)],
                    metal,
                    VERTICAL,
                )
        return half + at.uniform(0.3, 3)
    if road.kind in ("bazaar", "rural", "lane") and stage.chance(
        {"bazaar": 0.9}.get(road.kind, 0.3)
    ):
        # a bare verge: for some people's labels it is road, for others not
        wide = at.uniform(0.8, 4) if road.kind == "bazaar" else at.uniform(0.3, 1.2)
        dust = ground(stage, drawn(stage, EARTHS), drawn(stage, EARTHS), at.uniform(2, 20))
        truth = VOID if road.kind == "bazaar" else HORIZONTAL
        section = [(-half - wide, 0.01), (half + wide, 0.01)]
        swept(stage, road.course, section, dust, truth, at.uniform(0, 0.4), (0, road.length))
        return half + wide
    return half


def _cross(stage: Stage, road: Road, surface: Material) -> None:
    """Another road from the left, the right or both."""
    (low, high), course = road.gaps[0], road.course
    sides = stage.at.choice([(-70, 70), (-70, 0), (0, 70)])
    points = [course.at(k, across, 0.028) for k in (low, high) for across in sides]
    mesh = bpy.data.meshes.new("crossing")
    mesh.from_pydata(points, [], [(0, 1, 3, 2)])
    mesh.materials.append(surface)
    mesh.uv_layers.new(name="UV")
    stage.put(mesh, ROAD)


def _mark(stage: Stage, road: Road) -> None:
    """Lines between lanes and along edges, a zebra crossing, all worn more or less."""
    at, half, course = stage.at, road.course.half, road.course
    white = plain(
        stage, drawn(stage, [(0.75, 0.75, 0.73), (0.7, 0.68, 0.6), (0.7, 0.5, 0.1)]), 0.7, vary=0.5
    )
    span = (0, FAR)
    if stage.chance(0.75):
        for lane in [-half / 3, half / 3] if road.kind == "motorway" else [at.uniform(-0.2, 0.2)]:
            line = [(lane - 0.07, 0.036), (lane + 0.07, 0.036)]
            if stage.chance(0.7):
                for first in range(0, FAR, 7):
                    swept(stage, course, line, white, ROAD, span=(first, first + at.choice([3, 4])))
            else:
                swept(stage, course, line, white, ROAD, span=span)
    if stage.chance(0.5):
        for side in (-1, 1):
            out = side * (half - at.uniform(0.15, 0.6))
            swept(stage, course, [(out - 0.06, 0.036), (out + 0.06, 0.036)], white, ROAD, span=span)
    if road.kind == "street" and stage.chance(0.3):
        first = at.randint(START + 3, START + 20)
        for k in range(int(half * 2 / 1.0)):
            out = -half + 0.25 + k
            swept(
                stage,
                course,
                [(out, 0.037), (out + 0.5, 0.037)],
                white,
                ROAD,
                span=(first, first + 3),
            )


def _mark_bays(stage: Stage, road: Road) -> None:
    """The lines of a car park."""
    if stage.chance(0.4):
        return
    white = plain(stage, (0.7, 0.7, 0.68), 0.7, vary=0.5)
    for side in (-1, 1):
        for first in range(0, road.length - 3, 2):
            line = [(side * (road.course.half - 5), 0.036), (side * road.course.half, 0.036)]
            mesh = bpy.data.meshes.new("bay")
            ends = [road.course.at(first, *end) for end in line]
            mesh.from_pydata([*ends, *[(x, y + 0.12, z) for x, y, z in ends]], [], [(0, 1, 3, 2)])
            mesh.materials.append(white)
            stage.put(mesh, ROAD)


def _rails(stage: Stage, road: Road) -> None:
    """Tram tracks in the road."""
    steel = plain(stage, (0.35, 0.34, 0.33), 0.3, metal=0.9)
    middle = stage.at.uniform(-0.5, 0.5) * road.course.half
    for out in (middle - 0.72, middle + 0.72):
        swept(
            stage,
            road.course,
            [(out - 0.05, 0.036), (out + 0.05, 0.036)],
            steel,
            ROAD,
            span=(0, FAR),
        )


def _land(stage: Stage, road: Road, soil: Material) -> None:
    """The land to both sides, flat at first, then banks, ditches and hills; and a plain below."""
    at = stage.at
    steps = [0, 0.5, 1, 1.8, 3, 5, 8, 12, 18, 27, 40, 60, 90]
    for side in (-1, 1):
        slope = at.choice([0.0, 0.0, -0.25, 0.15, 0.5]) * (not road.gaps)
        flat = at.uniform(0.5, 4)
        most = at.uniform(2, 7)
        rises = [(float(step), slope * min(max(step - flat, 0), most)) for step in steps]
        road.land_rises[side] = rises
        section = [(side * (road.land + step), up) for step, up in rises]
        swept(stage, road.course, section, soil, HORIZONTAL, bumps=0.06 + 0.1 * abs(slope))
    under = [(-road.land - 0.6, -0.02), (road.land + 0.6, -0.02)]
    swept(stage, road.course, under, soil, HORIZONTAL)
    size, below = 900.0, min(point.z for point in road.course.points) - 1.5
    mesh = bpy.data.meshes.new("plain")
    mesh.from_pydata(
        [(-size, -size, below), (size, -size, below), (size, size, below), (-size, size, below)],
        [],
        [(0, 1, 2, 3)],
    )
    mesh.materials.append(soil)
    stage.put(mesh, HORIZONTAL)
