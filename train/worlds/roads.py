"""The road: its course over hills, its surface, its borders, the land beside it.

The land is swept along the course as well and follows its hills.
"""

from collections.abc import Sequence
from itertools import pairwise
from math import cos, pi, sin
from typing import NamedTuple

from mathutils import Vector

from train.worlds.course import END, FAR, SPACING, START, Course, Section, swept
from train.worlds.materials import Colour, drawn, ground, palette, paved, plain, trodden
from train.worlds.stage import Material, Stage
from train.worlds.truth import HORIZONTAL, ROAD, VERTICAL, VOID


class Kind(NamedTuple):
    """A kind of road.

    half: half its width in metres, from … to. bend, steepest: limits of its course. ragged:
    amplitude in metres of its edges. trees: from … to. vehicles: numbers, equally likely.
    """

    half: tuple[float, float]
    bend: float = 1.0
    steepest: float = 0.07
    ragged: float = 0.0
    trees: tuple[int, int] = (0, 14)
    vehicles: Sequence[int] = (0, 1, 3, 6)


KINDS = {
    "street": Kind((2.8, 6.5)),
    "rural": Kind((2.2, 3.8), ragged=0.07, trees=(0, 40)),
    "motorway": Kind((5.5, 9), bend=0.3),
    "track": Kind((1.2, 2.3), ragged=0.3, trees=(0, 40), vehicles=(0, 0, 0, 1)),
    "trail": Kind((1.2, 2.6), 1.0, 0.14, 0.3, (30, 70), (0, 0, 0, 1)),
    "overgrown": Kind((1.3, 3.0), 1.0, 0.25, 0.3, (0, 70), (0, 0, 0, 1)),
    "yard": Kind((7, 20), bend=0.0, steepest=0.0, vehicles=(2, 6, 12)),
    "bazaar": Kind((2.5, 6), ragged=0.3),
    "ramp": Kind((2.8, 5.5), bend=1.6, vehicles=(0, 1, 3)),  # by number
    "litter": Kind((1.1, 2.0), 1.0, 0.1, 0.25, (15, 70), (0, 0, 0, 1)),  # by number
    "lane": Kind((1.6, 2.6), ragged=0.1, trees=(4, 40), vehicles=(0, 0, 1)),
    "town": Kind((2.75, 14), bend=1.1, steepest=0.05),  # by number; train.worlds.towns
}

UNPAVED = ("track", "trail", "overgrown", "litter")
"""The third is a trail with grass on it between tall grass and bushes, the last one in a wood, of
the same ground as beside it except where wheels have worn it bare."""

MOTORWAYS = ("motorway", "ramp")
"""Paved roads between rails and barriers, with lanes and a shoulder beyond the edge line."""

EARTHS = palette("32 24 16, 40 36 30, 20 16 12, 30 30 29, 50 47 42, 40 20 11")
GREENS = palette("10 17 5, 16 20 7, 30 26 13, 7 11 4, 38 33 20")
LITTER = palette("20 13 7, 28 20 12, 15 12 8, 35 30 25")
SNOW = palette("75 78 84, 60 62 66")
CONCRETE = palette("45 44 42, 30 29 27, 55 52 46")
PAVINGS = palette("40 38 35, 28 28 28, 40 30 24, 18 18 18, 50 49 46")


class Road(NamedTuple):
    """Properties that the other parts need; land: where the land begins, from the middle.

    lane: the middle of the camera's lane, where there are lanes.
    """

    kind: str
    course: Course
    land: float
    season: str
    gaps: list[tuple[int, int]]
    length: int
    land_rises: dict[int, Section]
    lane: float | None = None

    def open(self, index: int) -> bool:
        """Return whether no road crosses at a point."""
        return not any(low - 3 <= index <= high + 3 for low, high in self.gaps)

    def spot(self, index: int, beyond: float, side: int) -> tuple[float, float, float]:
        """Return a position on the land, metres from its beginning."""
        rises = self.land_rises[side]
        between = (
            low + (high - low) * (beyond - near) / (far - near)
            for (near, low), (far, high) in pairwise(rises)
            if near <= beyond <= far
        )
        return self.course.at(
            index, side * (self.land + beyond), next(between, rises[-1][1]) - 0.05
        )


def drawn_course(stage: Stage, kind: Kind) -> Course:
    """Sample a gentle curve over gentle hills, narrower or wider by kind."""
    at = stage.at
    bend = kind.bend * at.choice([0.3, 1.0, 1.0])
    first, change = at.uniform(-0.012, 0.012) * bend, at.uniform(-0.00022, 0.00022) * bend
    wave, length = at.uniform(100, 300), SPACING
    steep = at.choice([0.0, min(0.02, kind.steepest), kind.steepest]) * at.choice([-1, 1])
    x, y, heading = 0.0, -START * length, 0.0
    points, headings = [], []
    for index in range(END):
        ahead = max(0.0, (index - START) * length)
        z = steep * wave / 2 / pi * (1 - cos(2 * pi * ahead / wave))
        points.append(Vector((x, y, z)))
        headings.append(heading)
        x, y = x + sin(heading) * length, y + cos(heading) * length
        heading += (first + change * max(index - START, 0)) * length * (index > START)
    return Course(points, headings, at.uniform(*kind.half))


def swept_between(
    stage: Stage, road: Road, section: Section, material: Material, truth: int = HORIZONTAL
) -> None:
    """Sweep a cross-section except where another road crosses."""
    first = 0
    for low, high in [*road.gaps, (road.length, road.length)]:
        swept(stage, road.course, section, material, truth, span=(first, low + 1))
        first = high


def painted(
    stage: Stage,
    road: Road,
    middle: float,
    half: float,
    material: Material,
    span: tuple[int, int] = (0, FAR),
) -> None:
    """Paint a line along the road; ``middle`` from the road's, half its width in metres."""
    line = [(middle - half, 0.036), (middle + half, 0.036)]
    swept(stage, road.course, line, material, ROAD, span=span)


# --- the whole --------------------------------------------------------------------------


def build_road(stage: Stage, kind: str, season: str) -> Road:
    """Build road, borders, markings and land of a world."""
    at = stage.at
    course = drawn_course(stage, KINDS[kind])
    crossing = kind in ("street", "bazaar", "rural") and stage.chance(0.4)
    where = at.randint(START + 6, START + 26)
    gaps = [(where, where + at.randint(4, 7))] if crossing else []
    length = at.randint(START + 12, START + 45) if kind == "yard" else END
    road = Road(kind, course, course.half, season, gaps, length, {})
    if kind == "litter":
        surface, soil = _wood(stage, season)
    else:
        surface, soil = _surface(stage, road), soil_of(stage, season)
    flat = [(course.half * (k / 4 - 1), 0.03) for k in range(9)]
    bumps = 0.04 * (kind in UNPAVED)
    swept(stage, course, flat, surface, ROAD, KINDS[kind].ragged, (0, min(FAR, length)), bumps)
    swept(stage, course, flat, surface, VOID, 0.0, (FAR - 1, length), bumps)
    if gaps:
        _cross(stage, road, surface)
    if kind in ("track", "trail", "lane") and stage.chance({"track": 0.55}.get(kind, 0.15)):
        wide = at.uniform(0.15, 0.4)
        truth = HORIZONTAL if wide > 0.22 else VOID
        swept(stage, course, [(-wide, 0.06), (0, 0.1), (wide, 0.06)], soil, truth, 0.15)
    road = road._replace(land=_bound(stage, road, surface))
    if kind == "yard":
        _mark_bays(stage, road)
    elif kind in MOTORWAYS:
        _mark_motorway(stage, road)
    elif kind not in (*UNPAVED, "lane"):
        _mark(stage, road)
    if kind == "street" and stage.chance(0.2):  # tram tracks
        steel = plain(stage, (0.35, 0.34, 0.33), 0.3, metal=0.9)
        middle = at.uniform(-0.5, 0.5) * course.half
        for rail in (middle - 0.72, middle + 0.72):
            painted(stage, road, rail, 0.05, steel)
    _land(stage, road, soil)
    return road


def _wood(stage: Stage, season: str) -> tuple[Material, Material]:
    """Return the materials of a trail and of the ground of a wood, which differ only in wear."""
    at = stage.at
    mine = {"snow": LITTER + SNOW[1:], "green": LITTER + GREENS}.get(season, LITTER)
    colours = (drawn(stage, mine, 0.35), drawn(stage, mine, 0.35))
    grain, contrast = at.uniform(3, 30), at.uniform(0.2, 0.65)
    bare = drawn(stage, EARTHS + LITTER, 0.35)
    wear = (at.choice([0.0, at.uniform(0, 0.5)]), at.uniform(0.25, 0.9))
    photo, state = ("litter", "litter"), stage.pick.getstate()
    beside = ground(stage, *colours, grain, contrast, photo=photo)
    stage.pick.setstate(state)  # of the same photographs
    return trodden(stage, colours, grain, contrast, bare, wear, photo), beside


def _surface(stage: Stage, road: Road) -> Material:
    """Return asphalt, concrete, cobbles, gravel or earth, sometimes wet or under snow."""
    at, half = stage.at, road.course.half
    wet = at.uniform(0.2, 1) if stage.chance(0.22) else 0.0
    slush = drawn(stage, SNOW) if road.season == "snow" and stage.chance(0.75) else None
    if road.kind == "overgrown" and stage.chance(0.6):
        return soil_of(stage, road.season)
    loose = road.kind in UNPAVED or (road.kind in ("yard", "lane", "bazaar") and stage.chance(0.35))
    if loose:
        colour = drawn(stage, EARTHS if road.kind == "track" else LITTER + EARTHS, 0.35)
        ruts = at.uniform(-0.25, 0.4)
        edge = drawn(stage, GREENS + LITTER) if stage.chance(0.5) else None
        stones = at.choice([0.0, 0.0, 0.06])
        return paved(stage, colour, half, wet, stones, slush, ruts, edge, "earth")
    tone = at.uniform(0.04, 0.34)
    colour = tuple(tone * at.uniform(0.96, 1.04) for _ in range(3))
    stones = at.uniform(0.1, 0.25) if road.kind in ("street", "lane") and stage.chance(0.2) else 0.0
    return paved(stage, colour, half, wet, stones, slush, at.uniform(-0.12, 0.2))


def soil_of(stage: Stage, season: str) -> Material:
    """Return the material of the land beside the road."""
    at = stage.at
    colours = {"snow": SNOW, "earth": EARTHS, "litter": LITTER, "dry": GREENS[2:3] + GREENS[4:]}
    mine: Sequence[Colour] = colours.get(season, GREENS)
    second = mine if stage.chance(0.6) or season == "snow" else EARTHS + LITTER
    grain = at.uniform(1, 12)
    kind = {"snow": "snow", "earth": "earth", "litter": "litter"}.get(season, "grass")
    photo = (kind, kind if second is mine else "earth")
    looks = (drawn(stage, mine), drawn(stage, second))
    return ground(stage, *looks, grain, at.uniform(0.15, 0.6), photo=photo)


def _bound(stage: Stage, road: Road, surface: Material) -> float:
    """Build kerbs and pavements, shoulders and rails or dust; return where the land begins."""
    at, half = stage.at, road.course.half
    if road.kind == "street":
        wide, high = at.uniform(1.2, 4.5), at.uniform(0.07, 0.18)
        paving = surface  # a pavement of the road's own colour, parted by a kerb alone, is not rare
        if not stage.chance(0.25):
            colour = drawn(stage, PAVINGS)
            paving = paved(stage, colour, 99, stones=at.choice([0.0, 0.0, 0.3, 0.5]))
        kerb = plain(stage, drawn(stage, PAVINGS), 0.9)
        for side in (-1, 1):
            if stage.chance(0.9):
                inner, outer = side * (half + 0.14), side * (half + wide)
                edge = [(side * half, 0.0), (side * half, high), (inner, high + 0.01)]
                swept_between(stage, road, edge, kerb)
                swept_between(stage, road, [(inner, high), (outer, high + 0.02)], paving)
        return half + wide
    if road.kind in MOTORWAYS:
        metal = plain(stage, drawn(stage, palette("45 45 47, 50 49 46")), 0.5)
        for side in (-1, 1):
            if stage.chance(0.3):  # a barrier of concrete on the edge
                a, b = side * half, side * (half + 0.5)
                wall = [(a, 0.0), (a + 0.15 * side, 0.3), (a + 0.2 * side, at.uniform(0.7, 1.1))]
                wall += [(b, wall[-1][1]), (b, 0.0)]
                swept(stage, road.course, wall, plain(stage, drawn(stage, CONCRETE), 0.9), VERTICAL)
            elif stage.chance(0.75):
                out = side * (half + at.uniform(0.1, 1.5))
                rail = [(out, at.choice([0.0, 0.5])), (out, 0.8), (out + 0.2 * side, 0.8)]
                swept(stage, road.course, rail, metal, VERTICAL)
        return half + at.uniform(0.3, 3)
    bare = {"bazaar": 0.9, "rural": 0.3, "lane": 0.3}
    if road.kind in bare and stage.chance(bare[road.kind]):
        # a bare verge: for some people's labels it is road, for others not
        wide = at.uniform(0.8, 4) if road.kind == "bazaar" else at.uniform(0.3, 1.2)
        dust = ground(stage, drawn(stage, EARTHS), drawn(stage, EARTHS), at.uniform(2, 20))
        truth = VOID if road.kind == "bazaar" else HORIZONTAL
        section = [(-half - wide, 0.01), (half + wide, 0.01)]
        swept(stage, road.course, section, dust, truth, at.uniform(0, 0.4), (0, road.length))
        return half + wide
    return half


def _cross(stage: Stage, road: Road, surface: Material) -> None:
    """Build another road from the left, the right or both."""
    sides = stage.at.choice([(-70, 70), (-70, 0), (0, 70)])
    points = [road.course.at(k, across, 0.028) for k in road.gaps[0] for across in sides]
    mesh = stage.mesh([((points, [(0, 1, 3, 2)]), surface)])
    mesh.uv_layers.new(name="UV")
    stage.put(mesh, ROAD)


def _mark(stage: Stage, road: Road) -> None:
    """Paint lines between lanes and along edges and a zebra crossing, with random wear."""
    at, half = stage.at, road.course.half
    white = _paint(stage)
    if stage.chance(0.75):
        _mark_line(stage, road, at.uniform(-0.2, 0.2), white, 0.7)
    if stage.chance(0.5):
        for side in (-1, 1):
            painted(stage, road, side * (half - _verge(stage, half)), 0.06, white)
    if road.kind == "street" and stage.chance(0.3):
        mark_zebra(stage, road, at.randint(START + 3, START + 20), white)


def _paint(stage: Stage) -> Material:
    colours = palette("75 75 73, 70 68 60, 70 50 10")
    return plain(stage, drawn(stage, colours), 0.7, vary=0.5)


def _verge(stage: Stage, half: float) -> float:
    """Sample the width in metres beyond an edge line: little, or a shoulder to stop on."""
    at = stage.at
    return min(at.uniform(1.2, 3.2) if stage.chance(0.35) else at.uniform(0.15, 0.7), half - 1)


def _mark_line(stage: Stage, road: Road, across: float, look: Material, dashed: float) -> None:
    """Paint a line between lanes, sometimes dashed."""
    if not stage.chance(dashed):
        painted(stage, road, across, 0.07, look)
        return
    for first in range(0, FAR, 7):
        span = (first, first + stage.at.choice([3, 4]))
        painted(stage, road, across, 0.07, look, span)


def _mark_motorway(stage: Stage, road: Road) -> None:
    """Paint edge lines beside shoulders, lines between lanes, hatched areas before exits."""
    at, half = stage.at, road.course.half
    left, right = at.sample([_verge(stage, half), at.uniform(0.15, 1.2)], 2)
    low, high, white = left - half, half - right, _paint(stage)
    for inner, outer in ((low, -half), (high, half)):
        if abs(outer - inner) > 1 and stage.chance(0.4):  # a shoulder of another asphalt
            tone = at.uniform(0.05, 0.35)
            look = paved(stage, (tone, tone, tone), half)
            strip = sorted([(inner, 0.033), (outer, 0.033)])
            swept(stage, road.course, strip, look, ROAD, span=(0, FAR))
        painted(stage, road, inner, at.uniform(0.06, 0.14), at.choice([white, _paint(stage)]))
    lanes = max(1, round((high - low) / at.uniform(3.3, 4.2)))
    for lane in range(1, lanes):
        _mark_line(stage, road, low + (high - low) * lane / lanes, white, 0.85)
    if stage.chance(0.35):
        _hatch(stage, road, at.choice([(low, -half), (high, half), (high, low)]), white)


def _hatch(stage: Stage, road: Road, sides: tuple[float, float], look: Material) -> None:
    """Paint oblique stripes in a wedge that opens from the first side towards the second."""
    at, (near, far) = stage.at, sides
    first, count = at.randint(START + 2, START + 25), at.randint(5, 14)
    wide = (far - near) * at.uniform(0.4, 1.0)
    for k in range(count):
        corners = []
        for index, out in ((first + k, near), (first + k + 1, near + wide * (k + 1) / count)):
            start, end = (Vector(road.course.at(index + step, out, 0.037)) for step in (0, 1))
            corners += [start, start.lerp(end, 0.4)]
        stage.put(stage.mesh([((corners, [(0, 1, 3, 2)]), look)]), ROAD)


def mark_zebra(stage: Stage, road: Road, first: int, white: Material) -> None:
    """Paint a zebra crossing from a point on."""
    half = road.course.half
    for k in range(int(half * 2 / 1.0)):
        out = -half + 0.25 + k
        stripe = [(out, 0.037), (out + 0.5, 0.037)]
        swept(stage, road.course, stripe, white, ROAD, span=(first, first + 3))


def _mark_bays(stage: Stage, road: Road) -> None:
    """Paint the lines of a car park."""
    if stage.chance(0.4):
        return
    white, half = plain(stage, (0.7, 0.7, 0.68), 0.7, vary=0.5), road.course.half
    for side in (-1, 1):
        for first in range(0, road.length - 3, 2):
            ends = [road.course.at(first, side * out, 0.036) for out in (half - 5, half)]
            points = [*ends, *[(x, y + 0.12, z) for x, y, z in ends]]
            stage.put(stage.mesh([((points, [(0, 1, 3, 2)]), white)]), ROAD)


def _land(stage: Stage, road: Road, soil: Material) -> None:
    """Build the land on both sides, flat, then banks, ditches and hills; and a plain below."""
    at, land = stage.at, road.land
    steps = [0, 0.5, 1, 1.8, 3, 5, 8, 12, 18, 27, 40, 60, 90]
    for side in (-1, 1):
        slope = at.choice([0.0, 0.0, -0.25, 0.15, 0.5]) * (not road.gaps)
        flat, most = at.uniform(0.5, 4), at.uniform(2, 7)
        rises = [(float(step), slope * min(max(step - flat, 0), most)) for step in steps]
        road.land_rises[side] = rises
        section = [(side * (land + step), up) for step, up in rises]
        swept(stage, road.course, section, soil, HORIZONTAL, bumps=0.06 + 0.1 * abs(slope))
    swept(stage, road.course, [(-land - 0.6, -0.02), (land + 0.6, -0.02)], soil, HORIZONTAL)
    plain_below(stage, road, soil, 1.5)


def plain_below(stage: Stage, road: Road, soil: Material, depth: float) -> None:
    """Build a plain some metres below the lowest point of the road."""
    size, below = 900.0, min(point.z for point in road.course.points) - depth
    corners = [(-size, -size, below), (size, -size, below), (size, size, below)]
    corners.append((-size, size, below))
    stage.put(stage.mesh([((corners, [(0, 1, 2, 3)]), soil)]), HORIZONTAL)
