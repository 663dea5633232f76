"""Objects beside the road and over it: plants, houses, posts, people, bridges, hills."""

from math import cos, pi, sin
from typing import Any

import bpy
from mathutils import Vector, noise

from train.worlds.course import START, swept
from train.worlds.materials import drawn, facade, ground, lamp, palette, plain
from train.worlds.obstacles import put_obstacles, put_people
from train.worlds.roads import EARTHS, GREENS, KINDS, LITTER, MOTORWAYS, SNOW, UNPAVED, Road
from train.worlds.stage import Parts, Point, Shape, Stage, box, loose, turned
from train.worlds.truth import HORIZONTAL, ROAD, VERTICAL

WALLS = palette("55 47 38, 40 18 12, 55 55 54, 25 25 27, 65 60 45, 50 35 25")


def build_surroundings(stage: Stage, road: Road, crowd: bool) -> None:
    """Build all objects for the road's kind; crowd: more people."""
    at = stage.at
    town = road.kind in ("street", "bazaar", "yard")
    wild = road.kind in (*UNPAVED, "rural", "lane")
    tones = {"dry": GREENS[2:] + LITTER, "snow": SNOW + LITTER, "litter": LITTER + GREENS}
    mine = tones.get(road.season, palette("6 12 3, 10 15 5, 4 9 3"))
    leaf = ground(stage, drawn(stage, mine, 0.4), drawn(stage, mine, 0.4), at.uniform(1, 5), 0.3, 0)
    if not town or stage.chance(0.3):
        _grass(stage, road, at.choice([0, 250, 700] if wild else [0, 150]))
    build_trees(stage, road, leaf, at.randint(*KINDS[road.kind].trees))
    bushes = [0, 10, 40] if wild else [0, 0, 8]
    _bushes(stage, road, leaf, at.choice([0, 60, 160] if road.kind == "overgrown" else bushes))
    if town or stage.chance(0.2):
        _houses(stage, road, at.randint(6, 22) if town else at.randint(1, 5))
    if stage.chance(0.4 if town else 0.25):
        _fence(stage, road)
    build_posts(stage, road, at.choice([0, 0, 3] if road.kind in UNPAVED else [0, 4, 9]))
    count = at.randint(3, 16) if road.kind == "bazaar" else at.choice([0, 2, 6]) * town
    put_people(stage, road.course, (road.course.half, road.land), 0.05, count + 8 * crowd)
    put_obstacles(stage, road.course, 0.05, at.randint(2, 10) * crowd)
    if road.kind in (*MOTORWAYS, "street", "rural") and stage.chance(0.16):
        build_bridge(stage, road)
    if road.kind == "yard":
        _end_of_yard(stage, road, leaf)
    if stage.chance(0.6):
        for _ in range(at.choice([1, 1, 2])):
            build_hills(stage)


# --- plants -----------------------------------------------------------------------------


def crown(stage: Stage, count: int, size: float) -> Shape:
    """Return loose leaves of a ``size`` in a ball of radius 1, through which light falls."""
    at = stage.at
    knots = [Vector((at.gauss(0, 0.45), at.gauss(0, 0.45), at.gauss(0, 0.4))) for _ in range(9)]
    points = []
    for _ in range(count):
        middle = at.choice(knots) + Vector([at.gauss(0, 0.24) for _ in range(3)])
        for _ in range(3):
            points.append(tuple(middle + Vector([at.uniform(-size, size) for _ in range(3)])))
    return loose(points)


def _fir(stage: Stage, tiers: int = 9) -> Shape:
    """Return tiers of hanging branches, 1 wide and 1 tall."""
    points = []
    for tier in range(tiers):
        low, reach = tier / tiers, 0.5 * (1 - tier / tiers) + 0.05
        for k in range(11):
            turn, wide = 2 * pi * k / 11 + tier, 0.25
            out = reach * stage.at.uniform(0.7, 1.1)
            points.append((0, 0, low + 0.16))
            points.append((out * cos(turn - wide), out * sin(turn - wide), low - 0.02))
            points.append((out * cos(turn + wide), out * sin(turn + wide), low))
    return loose(points)


def _bare(stage: Stage) -> Shape:
    """Return a tree without leaves: thin branches, radius 1."""
    at, points, half = stage.at, [], Vector((0.02, 0.015, 0))
    for _ in range(90):
        start = Vector((at.gauss(0, 0.12), at.gauss(0, 0.12), at.uniform(-1, 0.4)))
        end = start + Vector((at.gauss(0, 0.4), at.gauss(0, 0.4), at.uniform(0.2, 0.8)))
        points += [tuple(start - half), tuple(start + half), tuple(end)]
    return loose(points)


def build_trees(stage: Stage, road: Road, leaf: Any, count: int) -> None:
    """Plant broad-leaved, bare and fir trees; near ones cast shadows on the road."""
    at = stage.at
    bark = plain(stage, drawn(stage, palette("12 9 6, 20 17 14, 30 28 25")), 0.95, vary=0.5)
    wood = road.kind == "litter"
    bare = road.season == "snow" or stage.chance(0.5 if wood else 0.12)
    crowns = [_bare(stage) if bare else crown(stage, 1500, 0.1) for _ in range(2)]
    meshes = [stage.mesh([(shape, bark if bare else leaf)]) for shape in crowns]
    fir = stage.mesh([(_fir(stage), leaf)])
    trunk = stage.mesh([(turned([(0.5, 0), (0.35, 1)], 7), bark)])
    near, firs = at.uniform(0.4, 5 if wood else 3), at.choice([0.0, 0.2, 1.0])
    firs *= road.kind != "town"
    for _ in range(count):
        side, index = at.choice((-1, 1)), at.randint(START + 1, 110)
        if not road.open(index):
            continue
        where = road.spot(index, near + at.expovariate(0.12), side)
        turn = at.uniform(0, 6)
        if stage.chance(firs):
            tall = at.uniform(4, 14)
            stage.put(fir, VERTICAL, where, turn, (tall * 0.55, tall * 0.55, tall))
            continue
        wide, foot = at.uniform(1.5, 3.5), at.uniform(1.5, 4)
        tall = wide * at.uniform(0.8, 1.6)
        thick = at.uniform(0.06, 0.4) if wood else at.uniform(0.25, 0.6)
        stage.put(trunk, VERTICAL, where, turn, (thick, thick, foot + tall))
        top = (where[0], where[1], where[2] + foot + tall * 0.8)
        stage.put(at.choice(meshes), VERTICAL, top, turn, (wide, wide, tall))


def _bushes(stage: Stage, road: Road, leaf: Any, count: int) -> None:
    at = stage.at
    meshes = [stage.mesh([(crown(stage, 700, 0.2), leaf)]) for _ in range(2)]
    for _ in range(count):
        size = at.uniform(0.3, 1.4)
        beyond = size * (0.7 if road.kind == "overgrown" else 1) + at.expovariate(0.3)
        where = road.spot(at.randint(START + 2, 80), beyond, at.choice((-1, 1)))
        where = (where[0], where[1], where[2] + size * 0.5)
        stage.put(at.choice(meshes), VERTICAL, where, at.uniform(0, 6), (size, size, size))


def _grass(stage: Stage, road: Road, count: int) -> None:
    """Plant tufts of blades, most of them near the road's edge; low ones on an overgrown road."""
    at = stage.at
    overgrown = road.kind == "overgrown" or (
        road.kind in UNPAVED and stage.chance(0.15 if road.kind == "litter" else 0.45)
    )
    tall = at.uniform(0.6, 1.6) if overgrown else at.uniform(0.08, 0.5)
    count = max(count, 1400 if road.kind == "overgrown" else 700) if overgrown else count
    mesh, truth = _tuft(stage, road, tall), VERTICAL if overgrown else HORIZONTAL
    for _ in range(count):
        index = START - 3 + min(int(at.expovariate(0.06)), 90)
        beyond = (0.9 if overgrown else 0.8) + at.expovariate(0.4)
        where = road.spot(index, beyond, at.choice((-1, 1)))
        stage.put(mesh, truth, where, at.uniform(0, 6))
    if road.kind == "overgrown":
        low, inside = _tuft(stage, road, at.uniform(0.03, 0.16)), road.course.half - 1
        for _ in range(at.choice([0, 150, 600])):
            index = START - 3 + min(int(at.expovariate(0.06)), 90)
            where = road.course.at(index, at.uniform(-inside, inside), 0.02)
            stage.put(low, ROAD, where, at.uniform(0, 6))


def _tuft(stage: Stage, road: Road, tall: float) -> Any:
    """Return blades of grass on two by two metres."""
    at = stage.at
    tones = LITTER + GREENS[2:] if road.season in ("litter", "dry", "earth", "snow") else GREENS
    blade, points = plain(stage, drawn(stage, tones, 0.35), 0.8, vary=0.5), []
    for _ in range(220):
        x, y, turn = at.uniform(-1, 1), at.uniform(-1, 1), at.uniform(0, 6.28)
        high, dx, dy = at.uniform(0.3, 1) * tall, 0.025 * cos(turn), 0.025 * sin(turn)
        points += [(x + dx, y + dy, 0), (x - dx, y - dy, 0)]
        points.append((x + at.gauss(0, 0.3) * high, y + at.gauss(0, 0.3) * high, high))
    return stage.mesh([(loose(points), blade)])


# --- what people built ------------------------------------------------------------------


def _houses(stage: Stage, road: Road, count: int) -> None:
    """Build blocks and houses with roofs along the road, shops close to it in a bazaar."""
    at = stage.at
    index, roof = {-1: START - 6, 1: START - 6}, plain(stage, drawn(stage, WALLS), 0.9, vary=0.4)
    set_back = at.uniform(0.2, 2) if road.kind == "bazaar" else at.choice([0.5, 4, 10])
    for _ in range(count):
        side = at.choice((-1, 1))
        long, deep = at.uniform(5, 16), at.uniform(5, 10)
        tall = at.uniform(2.8, 5) if stage.chance(0.4) else at.uniform(6, 18)
        middle = index[side] + int(long / 3) + 1
        index[side] += int(long / 1.5) + at.choice([1, 1, 4])
        if middle > 115 or not road.open(middle) or (road.kind == "yard" and set_back < 4):
            continue
        where = road.spot(middle, set_back + deep / 2 + at.uniform(0, 1.5), side)
        wall = facade(stage, drawn(stage, WALLS))
        parts = [(box((0, 0, tall / 2 - 2), (deep, long, tall + 4)), wall)]
        if stage.chance(0.4):
            shape = gable(deep / 2 + 0.3, long / 2 + 0.3, tall, at.uniform(1, 3.5))
            parts.append((shape, roof))
        if stage.chance(0.3):
            awning = plain(stage, [at.uniform(0.05, 0.8) for _ in range(3)], 0.7)
            parts.append((box((-side * (deep / 2 + 0.6), 0, 2.6), (1.3, long * 0.8, 0.15)), awning))
        stage.put(stage.mesh(parts), VERTICAL, where, -road.course.headings[middle])


def gable(across: float, along: float, low: float, up: float) -> Shape:
    """Return a roof by half its metres across and along, its base height and its ridge's rise."""
    ends = [((-across, y, low), (across, y, low), (0.0, y, low + up)) for y in (-along, along)]
    return [*ends[0], *ends[1]], [(0, 1, 2), (3, 5, 4), (0, 2, 5, 3), (1, 4, 5, 2)]


def _fence(stage: Stage, road: Road) -> None:
    """Build a wall, a hedge or rails along the road."""
    at = stage.at
    beyond, tall, first = at.uniform(0.1, 4), at.uniform(0.5, 2.4), at.randint(0, 30)
    what = at.choice(["wall", "hedge", "rails"])
    for side in at.choice([(-1,), (1,), (-1, 1)]):
        if any(up > 0.2 for step, up in road.land_rises[side] if step < beyond + 2):
            continue
        out, span = side * (road.land + beyond), (first, at.randint(40, 125))
        if road.gaps:
            span = (road.gaps[0][1] + 2, 125)
        if what == "rails":
            metal = plain(stage, drawn(stage, WALLS), 0.6)
            for up in (tall * 0.35, tall * 0.7, tall):
                rail = [(out, up - 0.06), (out, up)]
                swept(stage, road.course, rail, metal, VERTICAL, span=span)
            continue
        far = out + (0.9 if what == "hedge" else 0.2) * side
        tones = GREENS[:2] + GREENS[3:4] if what == "hedge" else WALLS
        look = ground(stage, drawn(stage, tones), drawn(stage, tones), at.uniform(1, 8), 0.5, 0.9)
        section = [(out, -0.3), (out, tall), (far, tall), (far, -0.3)]
        bumps = 0.25 if what == "hedge" else 0
        swept(stage, road.course, section, look, VERTICAL, span=span, bumps=bumps)


def build_posts(stage: Stage, road: Road, count: int, lit: int | None = None) -> None:
    """Add lamp posts that are lit at night, and signs; lit: the side that has lamps."""
    at = stage.at
    grey = plain(stage, drawn(stage, palette("30 30 30, 15 12 9, 50 50 50")), 0.6)
    tall, spacing, beyond = at.uniform(4, 9), at.randint(9, 18), at.uniform(-0.2, 1.0)
    warm = at.choice(palette("100 60 25, 100 85 65, 80 90 100"))
    for number in range(count):
        side = at.choice((-1, 1)) if lit is None else lit
        index = START + 4 + number * spacing
        if index > 115:
            break
        where = road.spot(index, max(beyond, 0.2), side)
        parts: Parts = [(turned([(0.11, 0), (0.06, tall)], 8), grey)]
        parts.append((box((-side * 0.7, 0, tall), (1.6, 0.1, 0.1)), grey))
        if stage.night:
            parts.append((box((-side * 1.4, 0, tall - 0.1), (0.5, 0.25, 0.1)), lamp(warm, 60)))
        stage.put(stage.mesh(parts), VERTICAL, where, -road.course.headings[index])
        if stage.night:
            light = bpy.data.lights.new("lamp", "POINT")
            light.energy, light.color, light.shadow_soft_size = at.uniform(150, 600), warm, 0.2
            stage.add("lamp", light, (where[0] - side * 1.4, where[1], where[2] + tall - 0.4))
    for _ in range(at.choice([0, 1, 4]) * (count > 0)):
        index, side = at.randint(START + 3, 70), at.choice((-1, 1))
        colour = at.choice(palette("60 2 2, 2 8 50, 80 80 80, 70 50 2, 2 30 10"))
        middle, size = (
            (0, 0, at.uniform(1.8, 2.6)),
            (at.uniform(0.5, 1.4), 0.03, at.uniform(0.5, 0.9)),
        )
        sign: Parts = [(turned([(0.04, 0), (0.04, 2.5)], 6), grey)]
        sign.append((box(middle, size), plain(stage, colour, 0.5)))
        stage.put(stage.mesh(sign), VERTICAL, road.spot(index, 0.4, side), at.uniform(-0.3, 0.3))


def build_bridge(stage: Stage, road: Road) -> None:
    """Build a bridge across the road, which casts a band of shadow on it."""
    at = stage.at
    concrete = plain(stage, drawn(stage, WALLS), 0.9, vary=0.4)
    index, wide, high = at.randint(START + 5, START + 45), at.uniform(5, 14), at.uniform(4.3, 6)
    out = road.land + at.uniform(0.5, 4) + 1
    shapes = [box((0, 0, high + 0.6), (140, wide, 1.2))]
    shapes.append(box((0, -wide / 2, high + 1.5), (140, 0.2, 0.9)))
    shapes += [box((side * out, 0, high / 2 - 1), (2, wide, high + 2)) for side in (-1, 1)]
    mesh, where = (
        stage.mesh((shape, concrete) for shape in shapes),
        tuple(road.course.points[index]),
    )
    stage.put(mesh, VERTICAL, where, -road.course.headings[index])


def _end_of_yard(stage: Stage, road: Road, leaf: Any) -> None:
    """Build a house, a hedge, or only land at the end of a yard."""
    at, y = stage.at, road.course.points[road.length - 1].y
    what = at.choice(["house", "hedge", "nothing"])
    if what == "house":
        tall = at.uniform(3, 12)
        wall = facade(stage, drawn(stage, WALLS))
        house = box((at.uniform(-15, 15), y + 8, tall / 2), (40, 10, tall))
        stage.put(stage.mesh([(house, wall)]), VERTICAL)
    if what == "hedge":
        mesh = stage.mesh([(crown(stage, 700, 0.2), leaf)])
        for k in range(-16, 17):
            size = at.uniform(0.7, 1.6)
            where: Point = (k * 1.6, y + 2, size * 0.5)
            stage.put(mesh, VERTICAL, where, at.uniform(0, 6), (1.3, 1.3, size))


def build_hills(stage: Stage) -> None:
    """Build a row of woods, roofs or mountains at the horizon."""
    at = stage.at
    far, tall, seed = at.uniform(190, 480), at.uniform(3, 45), at.uniform(0, 99)
    tones = GREENS[:1] + GREENS[3:4] + EARTHS[:1] + [(0.2, 0.22, 0.25)]
    look = ground(stage, drawn(stage, tones), drawn(stage, tones), at.uniform(0.02, 0.2), 0.5, 0)
    points: list[Point] = []
    for k in range(241):
        turn = (k / 240 - 0.5) * 3.0
        rise = noise.fractal(Vector((turn * 3, seed, 0)), 0.9, 2.2, 6)
        x, y = far * sin(turn), far * cos(turn)
        points += [(x, y, -12.0), (x, y, tall * max(0.1, 0.6 + 0.7 * rise))]
    faces = [(k, k + 2, k + 3, k + 1) for k in range(0, 480, 2)]
    stage.put(stage.mesh([((points, faces), look)]), VERTICAL)
