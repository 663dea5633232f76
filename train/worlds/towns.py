"""Streets as towns have them: lanes both ways, kerbs, pavements, trams, parked cars, terraces.

Road is what people's labels of streets (Cityscapes) call road: every lane of both directions,
beyond a tram bed or an island too, tram tracks in the carriageway, and a cycle lane painted on it.
A cycle lane behind the kerb, a tram bed of its own, an island and the pavement are ground without
road; a parking bay of other paving is void, for labels differ.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from mathutils import Vector

from train.worlds.materials import drawn, facade, ground, lamp, palette, paved, plain, slabs
from train.worlds.roads import (
    END,
    FAR,
    KINDS,
    PAVINGS,
    SNOW,
    SPACING,
    START,
    Road,
    drawn_course,
    mark_zebra,
    painted,
    plain_below,
    soil_of,
    swept,
    swept_between,
)
from train.worlds.stage import (
    HORIZONTAL,
    ROAD,
    VERTICAL,
    VOID,
    Material,
    Parts,
    Stage,
    box,
    turned,
)
from train.worlds.surroundings import (
    WALLS,
    build_bridge,
    build_hills,
    build_posts,
    build_trees,
    crown,
    gable,
    person,
)
from train.worlds.vehicles import car, lorry, motorbike, van

CYCLE = palette("38 9 6, 8 20 9, 7 13 30, 40 14 8")
"""Paint of cycle lanes."""

REACH = 70
"""Metres to the end of a side street."""


class Street(NamedTuple):
    """What stands on a town's road: lanes as (across, direction); parking and walks as across."""

    lanes: list[tuple[float, int]]
    parking: dict[int, float]
    walks: dict[int, tuple[float, float]]
    tram: float | None
    kerb: float
    zebra: int | None


def build_town(stage: Stage, season: str) -> tuple[Road, Street]:
    """The carriageway with what lies on it, kerbs, pavements, side streets, the ground behind."""
    at = stage.at
    number, wide = at.choices((2, 3, 4, 6), (5, 2, 4, 1))[0], at.uniform(2.75, 3.5)
    bed = at.choice([at.uniform(1, 3), at.uniform(5.5, 7)]) if stage.chance(0.22) else 0.0
    half = number * wide / 2 + bed / 2
    course = drawn_course(stage, KINDS["town"])._replace(half=half)
    hand, gaps = at.choice((1, 1, -1)), _junctions(stage)
    road = Road("town", course, half, season, gaps, END, {})
    surface, walk = _surfaces(stage, road)
    flat = [(half * (k / 6 - 1), 0.03) for k in range(13)]
    swept(stage, course, flat, surface, ROAD, span=(0, FAR))
    swept(stage, course, flat, surface, VOID, span=(FAR - 1, END))
    kerb = at.uniform(0.02, 0.15)
    ends, parking, walks = [half, half], {}, {}
    for side in (-1, 1):
        out, parking[side] = _edge(stage, road, side, surface)
        walks[side] = _pavement(stage, road, side, out, kerb, walk)
        ends[side > 0] = walks[side][1]
    tram = _middle(stage, road, bed, kerb, walk)
    count = max(1, number // 2)
    lanes = [
        (side * hand * (bed / 2 + (k + 0.5) * (half - bed / 2) / count), side)
        for side in (-1, 1)
        for k in range(count)
    ]
    zebra = _mark_lanes(stage, road, lanes, bed)
    for low, high in gaps:
        _side_street(stage, road, (low, high), ends, kerb, (surface, walk))
    if season == "snow":
        _heaps(stage, road, ends)
    lane = at.choice([across for across, direction in lanes if direction > 0])
    road = road._replace(land=max(ends), lane=lane)
    _ground(stage, road)
    return road, Street(lanes, parking, walks, tram, kerb, zebra)


def _junctions(stage: Stage) -> list[tuple[int, int]]:
    """None, one ahead, or one in which the camera stands."""
    at = stage.at
    if stage.chance(0.4):
        return []
    first = START - at.randint(1, 3) if stage.chance(0.25) else at.randint(START + 3, START + 26)
    return [(first, first + at.randint(4, 8))]


def _surfaces(stage: Stage, road: Road) -> tuple[Material, Material]:
    """Of the carriageway and the pavement; wet together, snow on one, the other or both."""
    at = stage.at
    wet = at.uniform(0.3, 1.2) if stage.chance(0.35) else 0.0
    snow = road.season == "snow"
    lies = at.choices(["walk", "road", "both"], [4, 1, 2])[0] if snow else ""
    tone = at.uniform(0.04, 0.34)
    colour = tuple(tone * at.uniform(0.94, 1.06) for _ in range(3))
    stones = at.uniform(0.1, 0.22) if stage.chance(0.12) else 0.0
    slush = drawn(stage, SNOW) if lies in ("road", "both") else None
    surface = paved(stage, colour, road.course.half, wet, stones, slush, at.uniform(-0.12, 0.2))
    slush = drawn(stage, SNOW) if lies in ("walk", "both") else None
    wet *= stage.chance(0.7)
    kind = at.choices(["slabs", "same", "asphalt", "cobbles"], [5, 3, 2, 2])[0]
    if kind == "same" and not slush:
        return surface, surface
    if kind in ("slabs", "same"):
        return surface, slabs(stage, drawn(stage, PAVINGS), at.uniform(0.2, 0.8), wet, slush)
    other = drawn(stage, [colour]) if kind == "asphalt" else drawn(stage, PAVINGS)
    stones = at.uniform(0.06, 0.16) if kind == "cobbles" else 0.0
    return surface, paved(stage, other, 99, wet, stones, slush)


# --- the cross-section, from the carriageway's edge outwards ------------------------------


def _edge(stage: Stage, road: Road, side: int, surface: Material) -> tuple[float, float]:
    """Parking bays and a painted cycle lane; where the kerb is, and where cars are parked."""
    at, half = stage.at, road.course.half
    out, parked = half, 0.0
    if stage.chance(0.3):  # bays of another paving, or of the road's own
        wide, own = at.choice([2.0, 2.3, 4.6]), stage.chance(0.5)
        bay = surface if own else paved(stage, drawn(stage, PAVINGS), 99, 0.0, at.choice([0, 0.15]))
        section = [(side * half, 0.03), (side * (half + wide), 0.03)]
        swept_between(stage, road, section, bay, ROAD if own else VOID)
        out, parked = half + wide, side * (half + wide / 2)
    elif stage.chance(0.4):  # on the edge of the carriageway, or with two wheels on the pavement
        parked = side * (half + at.choice([-1.0, -0.9, 0.3, 1.1]))
    elif stage.chance(0.3):
        red, wide = plain(stage, drawn(stage, CYCLE), 0.9, vary=0.4), at.uniform(1.2, 1.9)
        painted(stage, road, side * (half - wide / 2 - 0.15), wide / 2, red)
    return out, parked


def _pavement(
    stage: Stage, road: Road, side: int, out: float, kerb: float, walk: Material
) -> tuple[float, float]:
    """Kerb, grass, a cycle lane, the walk itself; where one walks, from … to."""
    at = stage.at
    stone = plain(stage, drawn(stage, PAVINGS), 0.9, vary=0.3)
    rim = at.uniform(0.08, 0.3)
    edge = [(side * out, 0.0), (side * out, kerb), (side * (out + rim), kerb + 0.005)]
    swept_between(stage, road, edge, stone)
    out += rim
    strips: list[tuple[float, Material]] = []
    if stage.chance(0.2):
        strips.append((at.uniform(0.6, 2.5), soil_of(stage, road.season)))
    if stage.chance(0.12):
        red = plain(stage, drawn(stage, CYCLE), 0.9, vary=0.4)
        strips.append((at.uniform(1.2, 2.2), red))
    strips.append((at.uniform(1.2, 6), walk))
    inner = out
    for wide, look in strips:
        inner, up = out, kerb + 0.005
        swept_between(stage, road, [(side * out, up), (side * (out + wide), up + 0.01)], look)
        out += wide
    return inner, out


def _middle(stage: Stage, road: Road, bed: float, kerb: float, walk: Material) -> float | None:
    """An island or a tram bed between the directions, or tracks in the road; where a tram goes."""
    at = stage.at
    if bed:
        green = soil_of(stage, road.season)
        gravel = ground(stage, drawn(stage, PAVINGS), drawn(stage, PAVINGS), 12, 0.4, 0.8)
        top, a, up = at.choice([green, gravel, walk]), bed / 2, kerb + 0.03
        stone = plain(stage, drawn(stage, PAVINGS), 0.9, vary=0.3)
        for side in (-1, 1):
            swept_between(
                stage, road, [(side * a, 0), (side * a, up), (side * (a - 0.15), up)], stone
            )
        swept_between(stage, road, [(0.15 - a, up), (a - 0.15, up)], top)
        tracks = [-1.6, 1.6] if bed > 5 else []
    else:
        up = 0.0
        tracks = at.choice([[0.0], [-1.55, 1.55]]) if stage.chance(0.22) else []
    steel = plain(stage, (0.35, 0.34, 0.33), 0.25, metal=0.9)
    for middle in tracks:
        for rail in (middle - 0.72, middle + 0.72):
            line = [(rail - 0.05, up + 0.037), (rail + 0.05, up + 0.037)]
            swept(stage, road.course, line, steel, HORIZONTAL if bed else ROAD, span=(0, FAR))
    return at.choice(tracks) if tracks else None


def _mark_lanes(
    stage: Stage, road: Road, lanes: Sequence[tuple[float, int]], bed: float
) -> int | None:
    """Lines, stop lines, patches and lids, worn more or less; where a zebra crossing begins."""
    at, half = stage.at, road.course.half
    white = plain(stage, drawn(stage, palette("75 75 73, 70 68 60, 60 60 60")), 0.7, vary=0.5)
    yellow = plain(stage, drawn(stage, palette("70 50 10")), 0.7, vary=0.5)
    if stage.chance(0.75):
        middles = sorted(across for across, _ in lanes)
        for left, right in pairwise(middles):
            line, own = (left + right) / 2, at.choice([white, white, white, yellow])
            if left * right < 0 and bed:
                continue
            if left * right < 0 and stage.chance(0.5):
                painted(stage, road, line, 0.07, own)
                continue
            for first in range(0, FAR, 6):
                painted(stage, road, line, 0.07, own, (first, first + 3))
    if stage.chance(0.35):
        for side in (-1, 1):
            painted(stage, road, side * (half - at.uniform(0.15, 0.5)), 0.06, white)
    for _ in range(at.choice([0, 2, 6])):  # where a trench was mended
        tone = at.uniform(0.03, 0.2)
        look = plain(stage, (tone, tone, tone), 0.9, vary=0.3)
        first, middle = at.randint(START, START + 40), at.uniform(-0.9, 0.9) * half
        wide = at.choice([0.3, 0.3, at.uniform(0.3, 1.2)])
        span = (first, first + at.choice([2, 3, 12]))
        line = [(middle - wide, 0.0335), (middle + wide, 0.0335)]
        swept(stage, road.course, line, look, ROAD, span=span)
    if not stage.chance(0.35):
        return None
    first = at.randint(START + 2, START + 20)
    mark_zebra(stage, road, first, white)
    return first


def _side_street(
    stage: Stage,
    road: Road,
    gap: tuple[int, int],
    ends: Sequence[float],
    kerb: float,
    looks: tuple[Material, Material],
) -> None:
    """A street to the left, the right or both: carriageway, pavements, houses along and across."""
    (low, high), (surface, walk), at = gap, looks, stage.at
    opened = at.choice([(-1,), (1,), (-1, 1), (-1, 1)])
    for side in (-1, 1):
        edge, half = ends[side > 0], road.course.half
        if side not in opened:
            _slab(stage, road, gap, (side * half, side * edge), kerb + 0.005, walk, HORIZONTAL)
            continue
        _slab(stage, road, gap, (side * half * 0.9, side * REACH), 0.028, surface, ROAD)
        wide = at.uniform(1.0, 1.9)
        for span in ((low + 0.02 - wide, low + 0.02), (high - 0.02, high - 0.02 + wide)):
            across = (side * (edge - 0.05), side * REACH)
            _slab(stage, road, span, across, kerb + 0.014, walk, HORIZONTAL)
        for index in (low - 4, high + 4):  # houses at the corners, and where the street ends
            _corner(stage, road, index, side * (edge + 24), (46.0, 6.5))
        _corner(stage, road, (low + high) // 2, side * (REACH + 4), (8.0, 40.0))


def _slab(
    stage: Stage,
    road: Road,
    span: tuple[float, float],
    across: tuple[float, float],
    up: float,
    look: Material,
    truth: int,
) -> None:
    """A slab between two points of the course and two places across it, its top so far up."""
    points = []
    for height in (up, up - 0.25):
        for index in span:
            first = max(int(index), 0)
            for out in across:
                ends = [Vector(road.course.at(first + k, out, height)) for k in (0, 1)]
                points.append(tuple(ends[0].lerp(ends[1], index - first)))
    sides = [(0, 1, 3, 2), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    mesh = stage.mesh([((points, sides), look)])
    mesh.uv_layers.new(name="UV")
    stage.put(mesh, truth)


def _corner(stage: Stage, road: Road, index: int, across: float, size: tuple[float, float]) -> None:
    """A house beside a side street, of so many metres across and along the main road."""
    tall = stage.at.uniform(5, 20)
    wall = facade(stage, drawn(stage, WALLS))
    mesh = stage.mesh([(box((0, 0, tall / 2 - 2), (*size, tall + 4)), wall)])
    index = max(index, 0)
    stage.put(mesh, VERTICAL, road.course.at(index, across), -road.course.headings[index])


def _heaps(stage: Stage, road: Road, ends: Sequence[float]) -> None:
    """Snow that was shovelled to the kerb."""
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


def _ground(stage: Stage, road: Road) -> None:
    """What lies between and behind houses, and a plain below."""
    soil = soil_of(stage, road.season)
    for side in (-1, 1):
        road.land_rises[side] = [(0.0, 0.0), (90.0, 0.0)]
    swept(stage, road.course, [(-road.land - 14, -0.03), (road.land + 14, -0.03)], soil, HORIZONTAL)
    plain_below(stage, road, soil, 0.3)


# --- what stands and drives there ---------------------------------------------------------


def furnish_town(stage: Stage, road: Road, street: Street) -> None:
    """Terraces, houses or a park to each side, trees, lamps, bollards, people, traffic."""
    at = stage.at
    tones = {"snow": SNOW, "dry": palette("20 15 7, 28 20 12")}
    mine = tones.get(road.season, palette("6 12 3, 10 15 5, 4 9 3"))
    leaf = ground(stage, drawn(stage, mine, 0.4), drawn(stage, mine, 0.4), at.uniform(1, 5), 0.3, 0)
    for side in (-1, 1):
        kind = at.choices(["terrace", "houses", "park"], [6, 3, 1])[0]
        if kind == "park":
            _hedge(stage, road, side, street.walks[side][1], leaf)
        else:
            _terrace(stage, road, side, street.walks[side][1], kind == "houses")
    half = min(low for low, _ in street.walks.values())
    verge = road._replace(
        land=half, land_rises={side: [(0.0, 0.2), (90.0, 0.2)] for side in (-1, 1)}
    )
    build_trees(stage, verge, leaf, at.choice([0, 0, 6, 14]))
    build_posts(stage, verge, at.choice([0, 5, 10]))
    _bollards(stage, road, street)
    _people(stage, road, street)
    if stage.chance(0.08):
        build_bridge(stage, road)
    if stage.chance(0.5):
        build_hills(stage)
    _traffic(stage, road, street)


def _terrace(stage: Stage, road: Road, side: int, edge: float, apart: bool) -> None:
    """Fronts behind the pavement, wall to wall, or houses apart behind hedges and walls."""
    at, index = stage.at, START - 8
    roof = plain(stage, drawn(stage, WALLS), 0.9, vary=0.4)
    back = at.choice([2.0, 5.0]) if apart else at.choice([0.0, 0.0, 0.3, 1.0])
    even = at.uniform(5, 20)
    while index < 118:
        long, deep = at.uniform(6, 20), at.uniform(8, 12)
        tall = even * at.uniform(0.75, 1.25) if not apart else at.uniform(3, 9)
        middle = index + int(long / SPACING / 2)
        index += int(long / SPACING) + (
            at.choice([1, 3, 6]) if apart else at.choice([0, 0, 0, 0, 3])
        )
        if not (road.open(middle - 2) and road.open(middle + 2)) or middle >= END:
            continue
        wall = facade(stage, drawn(stage, WALLS))
        parts: Parts = [(box((0, 0, tall / 2 - 2), (deep, long, tall + 4)), wall)]
        face = -side * (deep / 2 + 0.02)
        if stage.chance(0.35) and not apart:  # a shop: its window, lit at night, and its awning
            light = at.uniform(0.4, 4) if stage.night else at.uniform(0, 0.2)
            shop = (
                lamp((1, 0.85, 0.65), light)
                if light > 0.1
                else plain(stage, (0.03, 0.03, 0.04), 0.1)
            )
            parts.append((box((face, 0, 1.5), (0.06, long * 0.8, 2.2)), shop))
            cloth = plain(stage, [at.uniform(0.05, 0.8) for _ in range(3)], 0.7)
            out = at.uniform(0.1, 1.2)
            parts.append((box((face - side * out / 2, 0, 2.8), (out, long * 0.85, 0.4)), cloth))
        if stage.chance(0.5):
            shape = gable(deep / 2 + 0.3, long / 2 + 0.1, tall, at.uniform(1, 3.5))
            parts.append((shape, roof))
        where = road.course.at(middle, side * (edge + back + deep / 2))
        stage.put(stage.mesh(parts), VERTICAL, where, -road.course.headings[middle])
    if apart:
        tall, wide = at.uniform(0.4, 1.9), at.uniform(0.15, 0.8)
        look = ground(stage, drawn(stage, WALLS), drawn(stage, WALLS), at.uniform(1, 8), 0.5, 0.9)
        a, b = side * (edge + 0.05), side * (edge + 0.05 + wide)
        section = [(a, -0.1), (a, tall), (b, tall), (b, -0.1)]
        swept_between(stage, road, section, look, VERTICAL)


def _hedge(stage: Stage, road: Road, side: int, edge: float, leaf: Material) -> None:
    """A park's edge: bushes in a row, or lawn alone."""
    at = stage.at
    if stage.chance(0.4):
        return
    mesh = stage.mesh([(crown(stage, 700, 0.2), leaf)])
    for index in range(START, 100):
        if road.open(index):
            size = at.uniform(0.6, 1.3)
            where = road.course.at(index, side * (edge + size + 0.2), size * 0.5)
            stage.put(mesh, VERTICAL, where, at.uniform(0, 6), (1.3, 1.3, size))


def _bollards(stage: Stage, road: Road, street: Street) -> None:
    """Along a kerb."""
    at = stage.at
    if stage.chance(0.65):
        return
    grey = plain(stage, drawn(stage, palette("3 3 3, 30 30 30, 60 58 50")), 0.6)
    mesh = stage.mesh([(turned([(0.08, 0), (0.08, at.uniform(0.6, 1.0)), (0.01, 1.02)], 8), grey)])
    side, spacing = at.choice((-1, 1)), at.choice([1, 2, 3])
    for index in range(START + 1, 70, spacing):
        if road.open(index):
            across = side * (street.walks[side][0] + 0.35)
            stage.put(mesh, VERTICAL, road.course.at(index, across, street.kerb))


def _people(stage: Stage, road: Road, street: Street) -> None:
    """On pavements, on the zebra crossing, some on the carriageway."""
    at = stage.at
    for _ in range(at.choice([0, 3, 8, 20])):
        index, side = START + 3 + min(int(at.expovariate(0.05)), 70), at.choice((-1, 1))
        across, up = side * at.uniform(*street.walks[side]), street.kerb
        if stage.chance(0.12):
            index = street.zebra or index
            across, up = at.uniform(-1, 1) * road.course.half, 0.03
        where = road.course.at(index, across, up)
        stage.put(stage.mesh(person(stage)), VERTICAL, where, at.uniform(0, 6))


def _traffic(stage: Stage, road: Road, street: Street) -> None:
    """In each lane none, a few or a queue; trams; cars parked in rows."""
    at, course = stage.at, road.course
    small = [
        stage.mesh(make(stage)) for make in at.choices([car] * 6 + [van] * 2 + [motorbike], k=5)
    ]
    large = stage.mesh(lorry(stage))
    own = road.lane or 0.0

    def stand(mesh: object, index: int, across: float, turn: float, up: float = 0.04) -> None:
        if index < 118:
            turn += at.gauss(0, 0.04) - course.headings[index]
            stage.put(mesh, VERTICAL, course.at(index, across, up), turn)

    for across, direction in street.lanes:
        gap = at.choice([0, 0, 25, 12, 5])
        index = START + (at.randint(4, 14) if across == own else at.randint(-2, 12))
        while gap and index < 100:
            big = stage.chance(0.1)
            stand(
                large if big else at.choice(small), index + 3 * big, across, 3.14 * (direction < 0)
            )
            index += 4 + 7 * big + int(at.expovariate(1 / gap))
    if street.tram is not None and stage.chance(0.35):
        index = START + at.randint(9, 40)
        stand(stage.mesh(_tram(stage)), index, street.tram, 0.0)
    for side, across in street.parking.items():
        if not across or (own * side > 0 and abs(own - across) < 1.9):
            continue
        full, turn = at.uniform(0.4, 0.95), 3.14 * stage.chance(0.4)
        square = abs(across) - course.half > 2  # bays across the street
        for index in range(START - 2, 95, 2 if square else 4):
            if road.open(index) and stage.chance(full):
                up = street.kerb if abs(across) - course.half in (1.1, 0.3) else 0.04
                stand(at.choice(small), index, across, turn + 1.57 * square, up)


def _tram(stage: Stage) -> Parts:
    """Two or three cars of a tram."""
    at, half = stage.at, 1.2
    body = plain(stage, drawn(stage, palette("60 55 40, 60 3 3, 4 20 45, 65 65 65")), 0.3)
    glass, dark = (
        plain(stage, (0.02, 0.02, 0.025), 0.06, vary=0),
        plain(stage, (0.02, 0.02, 0.02), 0.9),
    )
    light = lamp((1, 0.95, 0.8), 20 if stage.night else 2)
    parts: Parts = []
    for number in range(at.choice([2, 3])):
        y = number * 10.5
        parts.append((box((0, y, 1.85), (2 * half, 10, 3.0)), body))
        parts.append((box((0, y, 2.3), (2 * half + 0.06, 9.4, 1.1)), glass))
        parts.append((box((0, y, 0.25), (2 * half - 0.3, 9, 0.4)), dark))
        parts.append((box((0, y, 1.9), (2 * half - 0.2, 10.6, 2.7)), dark))
    parts.append((box((0, -5.03, 2.3), (2 * half - 0.3, 0.06, 1.2)), glass))
    return parts + [(box((x, -5.04, 0.9), (0.3, 0.06, 0.2)), light) for x in (-0.8, 0.8)]
