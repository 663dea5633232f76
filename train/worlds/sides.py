"""What borders the ground: fronts, houses, parks, plants, posts and lamps, bridges, hills."""

from math import cos, pi, sin
from typing import Any

from train.worlds.blender import Vector, noise
from train.worlds.materials import facade, ground, lamp, plain, sample_colour, sample_soil
from train.worlds.road import END, NARROW, SPACING, START, Road, sweep
from train.worlds.scene import Material, Parts, Point, Scene, Shape
from train.worlds.shapes import box, revolve, triangles
from train.worlds.truth import HORIZONTAL, ROAD, VERTICAL

FOLIAGE = {"dry": "dry litter", "snow": "snow litter", "litter": "litter green"}
"""Colours of leaves by season; of the others "foliage"."""


def build_sides(scene: Scene, road: Road) -> None:
    """Build what is along both sides of a road and over it."""
    rng, kind = scene.rng, road.kind
    leaf = sample_leaf(scene, FOLIAGE.get(road.season, "foliage"))
    if "tunnel" in kind.sides:
        _build_tunnel(scene, road)
        return
    for side in (-1, 1):
        border = scene.pick(kind.sides)
        if border in ("terrace", "shops", "houses"):
            _build_fronts(scene, road, side, border)
        elif border == "park" and scene.chance(0.6):
            spots = [(index, side) for index in range(START, 100) if road.is_open(index)]
            _plant_bushes(scene, road, leaf, spots)
        elif scene.chance(0.3):
            _build_fence(scene, road, side)
    count = rng.choice(kind.tufts)
    tall = {"overgrown": 1, "litter": 0.15}.get(road.name, 0.4 * (max(kind.tufts) > 500))
    if scene.chance(tall):
        _build_tufts(scene, road, max(count, 700), rng.uniform(0.6, 1.6), VERTICAL)
    elif count:
        _build_tufts(scene, road, count, rng.uniform(0.08, 0.5), HORIZONTAL)
    _build_trees(scene, road, leaf)
    count = rng.choice(kind.bushes)
    spots = [(rng.randint(START + 2, 80), rng.choice((-1, 1))) for _ in range(count)]
    _plant_bushes(scene, road, leaf, spots)
    _build_posts(scene, road)
    if road.length < END and scene.chance(0.7):  # the end of a yard
        wall, tall = facade(scene), rng.uniform(3, 12)
        x, y, z = road.course.position(road.length - 1, rng.uniform(-15, 15))
        scene.put(scene.mesh([(box((x, y + 8, z + tall / 2), (40, 10, tall)), wall)]), VERTICAL)
    for _ in range(rng.choice([0, 1, 1, 2])):
        _build_hills(scene)


# --- what people built ------------------------------------------------------------------


def _build_fronts(scene: Scene, road: Road, side: int, border: str) -> None:
    """Build fronts wall to wall, or houses apart behind hedges and walls, or low shops."""
    rng, edge, apart = scene.rng, road.ends[side], border == "houses"
    roof = plain(scene, "wall", 0.9, vary=0.4)
    back = rng.choice([1.0, 2.0, 5.0, 10.0]) if apart else rng.choice([0.0, 0.0, 0.3, 1.0])
    even, index = rng.uniform(3, 6) if border == "shops" else rng.uniform(5, 20), START - 8
    shops = {"shops": 0.7, "terrace": 0.65 if scene.water > 0.9 else 0.35, "houses": 0.0}[border]
    steps = [1, 3, 6] if apart else [0, 0, 0, 0, 3]
    while index < 118:
        long, deep = rng.uniform(6, 20), rng.uniform(8, 12)
        tall = rng.uniform(3, 9) if apart else even * rng.uniform(0.75, 1.25)
        middle = index + int(long / SPACING / 2)
        index += int(long / SPACING) + rng.choice(steps)
        if not (road.is_open(middle - 2) and road.is_open(middle + 2)) or middle >= END:
            continue
        parts: Parts = [(box((0, 0, tall / 2 - 2), (deep, long, tall + 4)), facade(scene))]
        face = -side * (deep / 2 + 0.02)
        if scene.chance(shops):  # its window, lit at night, and its awning
            window = plain(scene, (0.03, 0.03, 0.04), 0.1)
            if scene.night:
                window = lamp((1, rng.uniform(0.6, 1), rng.uniform(0.3, 1)), rng.uniform(0.4, 6))
            parts.append((box((face, 0, 1.5), (0.06, long * 0.8, 2.2)), window))
            cloth = plain(scene, [rng.uniform(0.05, 0.8) for _ in range(3)], 0.7)
            out = rng.uniform(0.1, 1.4)
            parts.append((box((face - side * out / 2, 0, 2.8), (out, long * 0.85, 0.4)), cloth))
        if scene.chance(0.5):
            parts.append((_gable(deep / 2 + 0.3, long / 2 + 0.1, tall, rng.uniform(1, 3.5)), roof))
        position = road.course.position(middle, side * (edge + back + deep / 2))
        scene.put(scene.mesh(parts), VERTICAL, position, -road.course.headings[middle])
    if apart and back > 1:
        _build_fence(scene, road, side, 0.05)


def _gable(across: float, along: float, low: float, up: float) -> Shape:
    """Return a roof by half its metres across and along, its base height and its ridge's rise."""
    ends = [((-across, y, low), (across, y, low), (0.0, y, low + up)) for y in (-along, along)]
    return [*ends[0], *ends[1]], [(0, 1, 2), (3, 5, 4), (0, 2, 5, 3), (1, 4, 5, 2)]


def _build_fence(scene: Scene, road: Road, side: int, beyond: float | None = None) -> None:
    """Build a wall, a hedge or rails along the land, metres from where it begins."""
    rng = scene.rng
    beyond = rng.uniform(0.1, 4) if beyond is None else beyond
    if any(up > 0.2 for step, up in road.rises[side] if step < beyond + 2):
        return
    tall, out = rng.uniform(0.5, 2.2), side * (road.ends[side] + beyond)
    border = rng.choice(["wall", "hedge", "rails"])
    if border == "rails":
        metal = plain(scene, "wall", 0.6)
        for up in (tall * 0.35, tall * 0.7, tall):
            sweep(scene, road, [(out, up - 0.06), (out, up)], metal, VERTICAL)
        return
    far = out + (0.8 if border == "hedge" else 0.2) * side
    tones = "foliage" if border == "hedge" else "wall"
    material = ground(scene, sample_soil(scene, tones)._replace(contrast=0.5), 0.9)
    section = [(out, -0.3), (out, tall), (far, tall), (far, -0.3)]
    sweep(scene, road, section, material, VERTICAL)


def _build_posts(scene: Scene, road: Road) -> None:
    """Add lamp posts that are lit at night."""
    rng, course = scene.rng, road.course
    count = rng.choice([0, 0, 3] if road.name in NARROW else [0, 5, 10])
    both_sides = scene.water > 0.9 or scene.chance(0.3)  # half of a street is often unlit
    count = max(count, 8) if scene.night and scene.water > 0.9 else count
    grey = plain(scene, "grey", 0.6)
    tall, spacing, beyond = rng.uniform(4, 9), rng.randint(8, 17), rng.uniform(0.2, 0.9)
    warm, gain = sample_colour(scene, "lamp", 0), rng.uniform(1, 4) if scene.water > 0.9 else 1
    spots = [(START + 3 + k * spacing, scene.hand * (-1) ** (k * both_sides)) for k in range(count)]
    for index, side in spots:
        if index > 115 or not road.is_open(index):
            continue
        across, up = side * (road.walks[side][0] + beyond), road.walks[side][2]
        x, y, z = course.position(index, across, up)
        arm = box((-side * 0.7, 0, tall), (1.6, 0.1, 0.1))
        parts: Parts = [(revolve([(0.11, 0), (0.06, tall)], 8), grey), (arm, grey)]
        if scene.night:
            parts.append((box((-side * 1.4, 0, tall - 0.1), (0.5, 0.25, 0.1)), lamp(warm, 60)))
            scene.add_lamp((x - side * 1.4, y, z + tall - 0.4), warm, gain * rng.uniform(150, 600))
        scene.put(scene.mesh(parts), VERTICAL, (x, y, z), -course.headings[index])


def _build_tunnel(scene: Scene, road: Road) -> None:
    """Build a tube over the road with lamps, around the camera or ahead of it."""
    rng, (left, right) = scene.rng, (road.ends[-1] + 0.1, road.ends[1] + 0.1)
    first = 0 if scene.chance(0.75) else START + rng.randint(8, 25)
    last = END if scene.chance(0.6) else first + rng.randint(25, 60)
    high, arch = rng.uniform(4.2, 6), rng.choice([0.0, 0.5, 1.0])
    section = [(-left, -0.3)]
    for k in range(13):
        turn = pi * k / 12
        across = (right - left) / 2 - cos(turn) * (left + right) / 2
        round_up = high * (0.45 + 0.55 * sin(turn))
        section.append((across, high + arch * (round_up - high)))
    section.append((right, -0.3))
    wall = ground(scene, sample_soil(scene, "concrete")._replace(contrast=0.3))
    sweep(scene, road, section, wall, VERTICAL, (first, last))
    warm = sample_colour(scene, "lamp", 0)
    watts, spacing = rng.uniform(60, 400), rng.randint(3, 7)
    rows = rng.choice([(0.0,), (-0.6, 0.6), (0.5,)])
    strip = scene.mesh([(box((0, 0, 0), (0.35, 1.6, 0.08)), lamp(warm, rng.uniform(8, 40)))])
    for index in range(first + 1, min(last, 90), spacing):
        for row in rows:
            side = (right - left) / 2 + row * (left + right) / 2
            up = (high if not arch else high * (1 - 0.5 * arch * row * row)) - 0.35
            position = road.course.position(index, side, up)
            scene.put(strip, VERTICAL, position, -road.course.heading(index))
            if index < 45:
                scene.add_lamp((*position[:2], position[2] - 0.2), warm, watts)


def _build_hills(scene: Scene) -> None:
    """Build a row of woods, roofs or mountains at the horizon."""
    rng = scene.rng
    far, tall, seed = rng.uniform(190, 480), rng.uniform(3, 45), rng.uniform(0, 99)
    soil = sample_soil(scene, "hill")._replace(grain=rng.uniform(0.02, 0.2), contrast=0.5)
    points: list[Point] = []
    for k in range(241):
        turn = (k / 240 - 0.5) * 3.0
        rise = noise.fractal(Vector((turn * 3, seed, 0)), 0.9, 2.2, 6)
        x, y = far * sin(turn), far * cos(turn)
        points += [(x, y, -12.0), (x, y, tall * max(0.1, 0.6 + 0.7 * rise))]
    faces = [(k, k + 2, k + 3, k + 1) for k in range(0, 480, 2)]
    scene.put(scene.mesh([((points, faces), ground(scene, soil, 0))]), VERTICAL)


# --- plants -----------------------------------------------------------------------------


def sample_leaf(scene: Scene, colours: str = "green") -> Material:
    """Sample a material of foliage."""
    soil = sample_soil(scene, colours)
    return ground(scene, soil._replace(grain=scene.rng.uniform(1, 5), contrast=0.3), 0)


def crown(scene: Scene, count: int = 700, size: float = 0.2) -> Shape:
    """Return loose leaves of a size in a ball of radius 1, through which light falls."""
    rng = scene.rng
    knots = [Vector((rng.gauss(0, 0.45), rng.gauss(0, 0.45), rng.gauss(0, 0.4))) for _ in range(9)]
    points = []
    for _ in range(count):
        middle = rng.choice(knots) + Vector([rng.gauss(0, 0.24) for _ in range(3)])
        for _ in range(3):
            points.append(tuple(middle + Vector([rng.uniform(-size, size) for _ in range(3)])))
    return triangles(points)


def _fir(scene: Scene, tiers: int = 9) -> Shape:
    """Return tiers of hanging branches, 1 wide and 1 tall."""
    points = []
    for tier in range(tiers):
        low, reach = tier / tiers, 0.5 * (1 - tier / tiers) + 0.05
        for k in range(11):
            turn, wide = 2 * pi * k / 11 + tier, 0.25
            out = reach * scene.rng.uniform(0.7, 1.1)
            points.append((0, 0, low + 0.16))
            points.append((out * cos(turn - wide), out * sin(turn - wide), low - 0.02))
            points.append((out * cos(turn + wide), out * sin(turn + wide), low))
    return triangles(points)


def _build_trees(scene: Scene, road: Road, leaf: Material) -> None:
    """Plant broad-leaved, bare and fir trees; near ones cast shadows on the road."""
    rng, wood, paved = scene.rng, road.name == "litter", road.kind.edges.keys() & {"kerb", "flush"}
    bark = plain(scene, "bark", vary=0.5)
    bare = road.season == "snow" or scene.chance(0.5 if wood else 0.12)
    crowns = [crown(scene, 150, 0.3) if bare else crown(scene, 1500, 0.1) for _ in range(2)]
    meshes = [scene.mesh([(shape, bark if bare else leaf)]) for shape in crowns]
    fir = scene.mesh([(_fir(scene), leaf)])
    trunk = scene.mesh([(revolve([(0.5, 0), (0.35, 1)], 7), bark)])
    near = rng.uniform(0.4, 5 if wood else 3)
    firs = 0.0 if paved else rng.choice([0.0, 0.2, 1.0])
    for _ in range(rng.randint(*road.kind.trees)):
        side, index = rng.choice((-1, 1)), rng.randint(START + 1, 110)
        if not road.is_open(index):
            continue
        x, y, z = road.land(index, near + rng.expovariate(0.12), side)
        if paved:  # on the pavement
            low, high, up = road.walks[side]
            x, y, z = road.course.position(index, side * min(low + near, high), up - 0.05)
        turn = rng.uniform(0, 6)
        if scene.chance(firs):
            tall = rng.uniform(4, 14)
            scene.put(fir, VERTICAL, (x, y, z), turn, (tall * 0.55, tall * 0.55, tall))
            continue
        wide, foot = rng.uniform(1.5, 3.5), rng.uniform(1.5, 4)
        tall = wide * rng.uniform(0.8, 1.6)
        thick = rng.uniform(0.06, 0.4) if wood else rng.uniform(0.25, 0.6)
        scene.put(trunk, VERTICAL, (x, y, z), turn, (thick, thick, foot + tall))
        top = (x, y, z + foot + tall * 0.8)
        scene.put(rng.choice(meshes), VERTICAL, top, turn, (wide, wide, tall))


def _plant_bushes(scene: Scene, road: Road, leaf: Material, spots: list[tuple[int, int]]) -> None:
    """Plant bushes at points of the course and sides; dense ones stand in a row."""
    rng, meshes = scene.rng, [scene.mesh([(crown(scene), leaf)]) for _ in range(2)]
    row = len({side for _, side in spots}) == 1
    for index, side in spots:
        size = rng.uniform(0.3, 1.4)
        beyond = size * (0.7 if road.name == "overgrown" else 1) + rng.expovariate(0.3) * (not row)
        x, y, z = road.land(index, beyond, side)
        position, turn = (x, y, z + size * 0.5), rng.uniform(0, 6)
        scene.put(rng.choice(meshes), VERTICAL, position, turn, (size, size, size))


def _build_tufts(scene: Scene, road: Road, count: int, tall: float, truth: int) -> None:
    """Plant tufts of blades, most of them near the road's edge; low ones on an overgrown road."""
    rng = scene.rng
    tones = "green" if road.season == "green" else "litter dry"
    mesh = tuft(scene, tones, tall, 1.0)
    for _ in range(count * (1 + (road.name == "overgrown"))):
        index = START - 3 + min(int(rng.expovariate(0.06)), 90)
        position = road.land(index, 0.9 + rng.expovariate(0.4), rng.choice((-1, 1)))
        scene.put(mesh, truth, position, rng.uniform(0, 6))
    if road.name == "overgrown":
        low, inside = tuft(scene, tones, rng.uniform(0.03, 0.16), 1.0), road.course.half - 1
        for _ in range(rng.choice([0, 150, 600])):
            index = START - 3 + min(int(rng.expovariate(0.06)), 90)
            position = road.course.position(index, rng.uniform(-inside, inside), 0.02)
            scene.put(low, ROAD, position, rng.uniform(0, 6))


def tuft(scene: Scene, colours: str, tall: float, reach: float) -> Any:
    """Return blades of grass within some metres."""
    rng = scene.rng
    blade, points = plain(scene, colours, vary=0.5), []
    for _ in range(int(160 + 60 * reach)):
        x, y, turn = rng.uniform(-reach, reach), rng.uniform(-reach, reach), rng.uniform(0, 6.28)
        high, dx, dy = rng.uniform(0.3, 1) * tall, 0.025 * cos(turn), 0.025 * sin(turn)
        points += [(x + dx, y + dy, 0), (x - dx, y - dy, 0)]
        points.append((x + rng.gauss(0, 0.3) * high, y + rng.gauss(0, 0.3) * high, high))
    return scene.mesh([(triangles(points), blade)])
