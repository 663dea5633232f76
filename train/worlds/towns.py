"""Streets of towns: lanes both ways, kerbs, pavements, trams, parked cars.

The camera drives in the outermost lane of its direction, and sees its own kerb to the end while
the lanes beyond leave the image; traffic keeps right or left. Road is what human labels of streets
(Cityscapes) call road: every lane of both directions, also beyond a tram bed or an island, tram
tracks in the carriageway, and a cycle lane painted on it. A cycle lane behind the kerb, a separate
tram bed, an island and the pavement are ground without road; a parking bay of other paving is void,
for labels differ.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from train.worlds.course import END, FAR, START, swept
from train.worlds.junctions import build_side_street, sample_junctions
from train.worlds.materials import drawn, ground, palette, paved, plain, slabs
from train.worlds.roads import (
    KINDS,
    PAVINGS,
    SNOW,
    Road,
    drawn_course,
    mark_zebra,
    painted,
    plain_below,
    soil_of,
    swept_between,
)
from train.worlds.stage import Material, Stage
from train.worlds.truth import HORIZONTAL, ROAD, VOID

CYCLE = palette("38 9 6, 8 20 9, 7 13 30, 40 14 8")
"""Colours of cycle lanes."""

GREY_KERB = (0.02, 0.05)
"""Height in metres of a pavement of the same grey as the road."""


class Street(NamedTuple):
    """The positions of things on a town's road.

    lanes: (across, direction), the camera's direction being 1. parking, walks: by side, where cars
    are parked and where people walk, metres from the middle. tram: of a tram. split: where
    the directions part. kerb: its height. zebra: where a crossing begins.
    """

    lanes: list[tuple[float, int]]
    parking: dict[int, float]
    walks: dict[int, tuple[float, float]]
    tram: float | None
    split: float
    kerb: float
    zebra: int | None


class Paving(NamedTuple):
    """Materials of carriageway, pavement and kerb stone; grey: whether all three are alike."""

    road: Material
    walk: Material
    stone: Material
    grey: bool


def build_town(stage: Stage, season: str) -> tuple[Road, Street]:
    """Build the carriageway with what lies on it, kerbs, pavements, side streets, the ground."""
    at = stage.at
    hand = stage.hand = stage.hand or at.choice((-1, 1))
    ways = {1: at.choices((1, 2), (6, 4))[0], -1: at.choices((1, 2, 3), (2, 4, 4))[0]}
    wide = at.uniform(2.8, 3.7)
    bed = at.choice([at.uniform(0.4, 3), at.uniform(5.5, 7)]) if stage.chance(0.2) else 0.0
    half = (ways[1] + ways[-1]) * wide / 2 + bed / 2
    split = hand * (half - ways[1] * wide - bed / 2)
    lanes = [
        (direction * hand * (half - wide * (k + 0.5)), direction)
        for direction in (1, -1)
        for k in range(ways[direction])
    ]
    course = drawn_course(stage, KINDS["town"])._replace(half=half)
    road = Road("town", course, half, season, sample_junctions(stage), END, {})
    paving = _sample_paving(stage, road)
    flat = [(half * (k / 6 - 1), 0.03) for k in range(13)]
    swept(stage, course, flat, paving.road, ROAD, span=(0, FAR))
    swept(stage, course, flat, paving.road, VOID, span=(FAR - 1, END))
    kerb = at.uniform(*GREY_KERB) if paving.grey else at.uniform(0.03, 0.15)
    ends, parking, walks = [half, half], {}, {}
    for side in (-1, 1):
        out, parking[side] = _build_edge(stage, road, side, paving)
        walks[side] = _build_pavement(stage, road, side, out, kerb, paving)
        ends[side > 0] = walks[side][1]
    tram = _build_middle(stage, road, split, bed, kerb, paving)
    zebra = _mark_lanes(stage, road, lanes, bed)
    for gap in road.gaps:
        build_side_street(stage, road, gap, ends, kerb, (paving.road, paving.walk))
    if season == "snow":
        _build_heaps(stage, road)
    road = road._replace(land=max(ends), lane=lanes[0][0] + hand * at.uniform(-0.1, 0.5))
    _build_ground(stage, road)
    return road, Street(lanes, parking, walks, tram, split, kerb, zebra)


def _sample_paving(stage: Stage, road: Road) -> Paving:
    """Sample materials, all wet together, with snow on one, the other or both."""
    at, snow = stage.at, road.season == "snow"
    share = 0.3 if stage.wet is None else float(stage.wet)
    wet = at.uniform(0.4, 1.3) if stage.chance(share) else 0.0
    lies = at.choices(["walk", "road", "both"], [4, 1, 2])[0] if snow else ""
    tone = at.uniform(0.04, 0.34)
    colour = tuple(tone * at.uniform(0.94, 1.06) for _ in range(3))
    stones = at.uniform(0.1, 0.22) if stage.chance(0.12) else 0.0
    slush = drawn(stage, SNOW) if lies in ("road", "both") else None
    surface = paved(stage, colour, road.course.half, wet, stones, slush, at.uniform(-0.12, 0.2))
    slush = drawn(stage, SNOW) if lies in ("walk", "both") else None
    if stage.chance(0.55) and lies != "walk":
        stone = plain(stage, [c * at.uniform(0.8, 1.25) for c in colour], 0.9, vary=0.3)
        kind = at.choices(["same", "asphalt", "slabs"], [3, 3, 2])[0]
        if kind == "same":
            return Paving(surface, surface, stone, True)
        near = tuple(c * at.uniform(0.92, 1.08) for c in colour)
        if kind == "slabs":
            return Paving(
                surface, slabs(stage, near, at.uniform(0.2, 0.8), wet, slush), stone, True
            )
        return Paving(surface, paved(stage, near, 99, wet, 0.0, slush), stone, True)
    stone = plain(stage, drawn(stage, PAVINGS), 0.9, vary=0.3)
    kind, own = at.choices(["slabs", "asphalt", "cobbles"], [5, 2, 2])[0], drawn(stage, PAVINGS)
    if kind == "slabs":
        return Paving(surface, slabs(stage, own, at.uniform(0.2, 0.8), wet, slush), stone, False)
    stones = at.uniform(0.06, 0.16) if kind == "cobbles" else 0.0
    return Paving(surface, paved(stage, own, 99, wet, stones, slush), stone, False)


# --- the cross-section, from the carriageway's edge outwards ------------------------------


def _build_edge(stage: Stage, road: Road, side: int, paving: Paving) -> tuple[float, float]:
    """Build parking bays or a painted cycle lane; return where kerb and parked cars are."""
    at, half, near = stage.at, road.course.half, side == stage.hand
    out, parked = half, 0.0
    if stage.chance(0.06 if near else 0.2):  # bays of another paving, or of the road's own
        wide, own = at.choice([2.0, 2.3, 4.6]), stage.chance(0.5)
        stones = at.choice([0, 0.15])
        bay = paving.road if own else paved(stage, drawn(stage, PAVINGS), 99, 0.0, stones)
        section = [(side * half, 0.03), (side * (half + wide), 0.03)]
        swept_between(stage, road, section, bay, ROAD if own else VOID)
        out, parked = half + wide, side * (half + wide / 2)
    elif stage.chance(0.1 if near else 0.25):  # on the edge, or with two wheels on the pavement
        parked = side * (half + at.choice([-1.0, -0.9, 0.3, 1.1]))
    elif stage.chance(0.25):
        red, wide = plain(stage, drawn(stage, CYCLE), 0.9, vary=0.4), at.uniform(1.2, 1.9)
        painted(stage, road, side * (half - wide / 2 - 0.15), wide / 2, red)
    return out, parked


def _build_pavement(
    stage: Stage, road: Road, side: int, out: float, kerb: float, paving: Paving
) -> tuple[float, float]:
    """Build kerb, grass, a cycle lane and the walk; return the extent of the walk."""
    at = stage.at
    rim = at.uniform(0.08, 0.2 if paving.grey else 0.3)
    edge = [(side * out, 0.0), (side * out, kerb), (side * (out + rim), kerb + 0.005)]
    swept_between(stage, road, edge, paving.stone)
    out += rim
    strips: list[tuple[float, Material]] = []
    if stage.chance(0.08 if paving.grey else 0.2):
        strips.append((at.uniform(0.6, 2.5), soil_of(stage, road.season)))
    if stage.chance(0.12):
        red = plain(stage, drawn(stage, CYCLE), 0.9, vary=0.4)
        strips.append((at.uniform(1.2, 2.2), red))
    strips.append((at.uniform(2.4, 3.8) if paving.grey else at.uniform(1.2, 6), paving.walk))
    inner = out
    for wide, look in strips:
        inner, up = out, kerb + 0.005
        swept_between(stage, road, [(side * out, up), (side * (out + wide), up + 0.01)], look)
        out += wide
    return inner, out


def _build_middle(
    stage: Stage, road: Road, split: float, bed: float, kerb: float, paving: Paving
) -> float | None:
    """Build an island or a tram bed between the directions, or tracks in the road.

    Returns the position of a tram.
    """
    at = stage.at
    if bed:
        green = soil_of(stage, road.season)
        gravel = ground(stage, drawn(stage, PAVINGS), drawn(stage, PAVINGS), 12, 0.4, 0.8)
        top, a, up = at.choice([green, gravel, paving.walk]), bed / 2, kerb + 0.03
        for side in (-1, 1):
            rim = [(side * a, 0), (side * a, up), (side * (a - 0.15), up)]
            shifted = [(split + across, height) for across, height in rim]
            swept_between(stage, road, shifted, paving.stone)
        swept_between(stage, road, [(split + 0.15 - a, up), (split + a - 0.15, up)], top)
        tracks = [split - 1.6, split + 1.6] if bed > 5 else []
    else:
        up = 0.0
        beyond = split - stage.hand * at.uniform(1.4, 1.9)
        pairs = [[split - 1.55, split + 1.55], [beyond], [beyond]]
        tracks = at.choice(pairs) if stage.chance(0.4) else []
    steel = plain(stage, (0.35, 0.34, 0.33), 0.25, metal=0.9)
    for middle in tracks:
        for rail in (middle - 0.72, middle + 0.72):
            line = [(rail - 0.05, up + 0.037), (rail + 0.05, up + 0.037)]
            swept(stage, road.course, line, steel, HORIZONTAL if bed else ROAD, span=(0, FAR))
    return at.choice(tracks) if tracks else None


def _mark_lanes(
    stage: Stage, road: Road, lanes: Sequence[tuple[float, int]], bed: float
) -> int | None:
    """Paint lines, patches and a zebra crossing with random wear; return where that begins."""
    at, half = stage.at, road.course.half
    white = plain(stage, drawn(stage, palette("75 75 73, 70 68 60, 60 60 60")), 0.7, vary=0.5)
    yellow = plain(stage, drawn(stage, palette("70 50 10")), 0.7, vary=0.5)
    if stage.chance(0.75):
        for (left, one), (right, other) in pairwise(sorted(lanes)):
            line, paint = (left + right) / 2, at.choice([white, white, white, yellow])
            if one != other and bed:
                continue
            if one != other and stage.chance(0.5):
                painted(stage, road, line, 0.07, paint)
                continue
            for first in range(0, FAR, 6):
                painted(stage, road, line, 0.07, paint, (first, first + 3))
    if stage.chance(0.35):
        for side in (-1, 1):
            painted(stage, road, side * (half - at.uniform(0.15, 0.5)), 0.06, white)
    for _ in range(at.choice([0, 2, 6])):  # where a trench was mended
        tone = at.uniform(0.03, 0.2)
        look = plain(stage, (tone, tone, tone), 0.9, vary=0.3)
        first, middle = at.randint(START, START + 40), at.uniform(-0.9, 0.9) * half
        wide = at.choice([0.3, 0.3, at.uniform(0.3, 1.2)])
        wide = min(wide, half - abs(middle))
        span = (first, first + at.choice([2, 3, 12]))
        line = [(middle - wide, 0.0335), (middle + wide, 0.0335)]
        swept(stage, road.course, line, look, ROAD, span=span)
    if not stage.chance(0.35):
        return None
    first = at.randint(START + 2, START + 20)
    mark_zebra(stage, road, first, white)
    return first


def _build_heaps(stage: Stage, road: Road) -> None:
    """Build heaps of snow shovelled to the kerb."""
    at = stage.at
    for side in (-1, 1):
        if stage.chance(0.5):
            continue
        middle, wide = side * (road.course.half + at.uniform(-0.3, 0.6)), at.uniform(0.2, 0.6)
        clean, grey = drawn(stage, SNOW), drawn(stage, palette("40 40 41, 25 24 23"))
        look = ground(stage, clean, grey, at.uniform(2, 8), 0.4, 0.6)
        section = [(middle - wide, -0.1), (middle, at.uniform(0.1, 0.45)), (middle + wide, -0.1)]
        first = at.randint(START - 4, START + 10)
        span = (first, at.randint(first + 10, 120))
        swept(stage, road.course, section, look, HORIZONTAL, 0.1, span, bumps=0.15)


def _build_ground(stage: Stage, road: Road) -> None:
    """Build the ground between and behind houses, and a plain below."""
    soil = soil_of(stage, road.season)
    for side in (-1, 1):
        road.land_rises[side] = [(0.0, 0.0), (90.0, 0.0)]
    swept(stage, road.course, [(-road.land - 14, -0.03), (road.land + 14, -0.03)], soil, HORIZONTAL)
    plain_below(stage, road, soil, 0.3)
