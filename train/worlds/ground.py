"""The ground: a carriageway on a course, strips beside it from its edge outwards, the land.

Road is what human labels of streets (Cityscapes) call road: every lane of both directions, also
beyond an island, tram tracks in the carriageway, a cycle lane painted on it, setts between kerbs.
Ground without road: pavements, plazas and cycle paths, also where nothing but their colour or their
stones parts them from the carriageway; islands, separate tram beds. Parking bays of other paving,
gutters and dusty edges are void, for labels differ.
"""

from typing import NamedTuple

from train.worlds import materials
from train.worlds.materials import Paving, ground, pave, plain, sample_colour, sample_paving, scale
from train.worlds.plans import ROADLESS, Weights
from train.worlds.road import (
    END,
    FAR,
    KINDS,
    MOTORWAYS,
    NARROW,
    START,
    Kind,
    Limits,
    Road,
    Span,
    sample_course,
    sweep,
)
from train.worlds.scene import Material, Scene
from train.worlds.shapes import box
from train.worlds.tables import read_column, read_table
from train.worlds.truth import HORIZONTAL, ROAD, VERTICAL, VOID

WEIGHTS: dict[str, Weights] = read_column("weights", "weights")


def build_ground(scene: Scene, name: str) -> Road:
    """Build carriageway, edges, side streets and land of a kind."""
    rng, kind, season = scene.rng, KINDS[name], scene.pick(WEIGHTS["seasons"])
    half, lanes, bed, split = _sample_lanes(scene, kind)
    truth = HORIZONTAL if name in ROADLESS else ROAD
    road = Road(name, kind, truth, sample_course(scene, half, kind.bend, kind.steepest), season)
    road.lanes = lanes
    if kind.marks == "bays":
        road.parking = {side: (side * (half - 2.4), 0.04) for side in (-1, 1)}
    road.length = rng.randint(START + 12, START + 45) if name == "yard" else END
    if kind.marks in ("town", "lanes") and name != "tunnel" and scene.chance(0.42):
        first = rng.randint(START + 4, START + 30)
        first = START - rng.randint(1, 3) if scene.chance(0.15) else first
        road.gaps = [(first, first + rng.randint(4, 8))]
    if kind.marks == "town" or (name in ("plaza", "setts", "tunnel") and scene.chance(0.7)):
        road.lane = lanes[0][0] + scene.hand * rng.uniform(-0.1, 0.5)
    surfaces = _sample_surfaces(scene, road)
    _lay_carriageway(scene, road, surfaces)
    edge = scene.pick(kind.edges)
    for side in (-1, 1):
        edge = edge if scene.chance(0.8) else scene.pick(kind.edges)
        _build_edge(scene, road, side, edge, surfaces)
    if bed or kind.marks == "town":
        _build_middle(scene, road, split, bed, surfaces)
    for gap in road.gaps:
        _build_side_street(scene, road, gap, surfaces)
    _build_land(scene, road, surfaces.soil)
    return road


def _sample_lanes(scene: Scene, kind: Kind) -> tuple[float, list[tuple[float, int]], float, float]:
    """Sample half the width, the lanes, the width of what is between directions, its middle."""
    rng, hand = scene.rng, scene.hand
    if kind.marks != "town":
        half = scene.between(kind.half)
        count = max(1, round(2 * half / rng.uniform(2.9, 3.9)))
        wide = 2 * half / count
        lanes = [(hand * (half - wide * (k + 0.5)), 1) for k in range(count)]
        if kind.marks != "motorway":
            lanes = [(across, 1 if hand * across >= 0 else -1) for across, _ in lanes]
        return half, lanes, 0.0, 0.0
    ways = {1: rng.choices((1, 2), (6, 4))[0], -1: rng.choices((1, 2, 3), (2, 4, 4))[0]}
    wide = rng.uniform(2.8, 3.7)
    bed = rng.choice([rng.uniform(0.4, 3), rng.uniform(5.5, 7)]) if scene.chance(0.2) else 0.0
    half = (ways[1] + ways[-1]) * wide / 2 + bed / 2
    lanes = [
        (direction * hand * (half - wide * (k + 0.5)), direction)
        for direction in (1, -1)
        for k in range(ways[direction])
    ]
    return half, lanes, bed, hand * (half - ways[1] * wide - bed / 2)


# --- surfaces ---------------------------------------------------------------------------


class Surfaces(NamedTuple):
    """Materials of carriageway, pavement, kerb stone, land; grey: all alike; kerb: its height."""

    road: Material
    walk: Material
    stone: Material
    soil: Material
    grey: bool
    kerb: float


def _sample_surfaces(scene: Scene, road: Road) -> Surfaces:
    """Sample materials, all wet together, with snow on one, the other or both."""
    rng, half, snowy = scene.rng, road.course.half, road.season == "snow"
    land = ground(scene, _sample_season(scene, road.season))
    name = scene.pick(road.kind.surface)
    if name in ("worn", "soil", "loose"):
        surface = _sample_loose(scene, road) if name == "loose" else land
        if name == "worn":
            land, surface = _sample_wood(scene, road.season)
        return Surfaces(surface, land, plain(scene, "paving"), land, False, 0.1)
    lies = scene.pick({"walk": 4, "road": 1, "walk road": 2}) if snowy else ""
    slush, white = ((sample_colour(scene, "snow") if p in lies else ()) for p in ("road", "walk"))
    tones = {"cycle": "cycle", "asphalt": [materials.sample_grey(scene)]}.get(name, "paving")
    paving = sample_paving(scene, tones, {"asphalt" if name == "cycle" else name: 1}, slush)
    top = pave(scene, paving, half, rng.uniform(-0.12, 0.2) * (road.truth == ROAD))
    grey = scene.chance(0.8 if scene.water > 0.9 else 0.5) and not white
    tones, patterns = "paving", WEIGHTS["pavement"]
    if grey:
        patterns = WEIGHTS["pavement grey"]
        tones = [scale(paving.colour, rng.uniform(0.92, 1.08))]
    walk = pave(scene, sample_paving(scene, tones, patterns, white))
    if grey and scene.chance(0.4):
        walk = top
    stone = scale(paving.colour, rng.uniform(0.8, 1.25)) if grey else "paving"
    kerb = rng.uniform(0.02, 0.05) if grey else rng.uniform(0.03, 0.17)
    return Surfaces(top, walk, plain(scene, stone, 0.9, vary=0.3), land, grey, kerb)


def _sample_season(scene: Scene, season: str) -> materials.Soil:
    """Sample the soil of the land beside the road."""
    litter = "" if season == "snow" or scene.chance(0.6) else "earth litter"
    soil = materials.sample_soil(scene, season, litter)
    covered = season == "litter" and scene.chance(0.6)
    return soil._replace(leaves=scene.rng.uniform(0.15, 0.9) * covered)


def _sample_loose(scene: Scene, road: Road) -> Material:
    """Return gravel or earth with wheel tracks, frayed edges, sometimes stones, snow, puddles."""
    rng = scene.rng
    colours = "earth" if road.name == "track" else "litter earth"
    paving = Paving(sample_colour(scene, colours, 0.35), water=scene.water)
    if scene.chance(1 / 3):
        paving = paving._replace(pattern="cobbles", size=0.06)
    if road.season == "snow" and scene.chance(0.75):
        paving = paving._replace(slush=sample_colour(scene, "snow"))
    edge = sample_colour(scene, "green litter") if scene.chance(0.5) else ()
    return pave(scene, paving, road.course.half, rng.uniform(-0.25, 0.4), edge)


def _sample_wood(scene: Scene, season: str) -> tuple[Material, Material]:
    """Return the materials of a wood's ground and of a trail in it, which differ only in wear."""
    rng = scene.rng
    tones = f"litter {season if season in ('snow', 'green') else ''}"
    soil = materials.sample_soil(scene, tones)._replace(grain=rng.uniform(3, 30))
    if scene.chance(0.7):
        soil = soil._replace(leaves=rng.uniform(0.3, 1.1))
    bare = sample_colour(scene, "earth litter", 0.35)
    wear = (rng.choice([0.0, rng.uniform(0, 0.5)]), rng.uniform(0.1, 0.9))
    state = rng.getstate()
    land = ground(scene, soil)
    rng.setstate(state)  # the same leaves and patches
    return land, ground(scene, soil, bare=bare, wear=wear)


def _lay_carriageway(scene: Scene, road: Road, surfaces: Surfaces) -> None:
    """Lay the carriageway; a loose one is sunken and rutted, sometimes with a grassy ridge."""
    rng, half, kind = scene.rng, road.course.half, road.kind
    loose = "asphalt" not in kind.surface and road.name in NARROW
    sunk, rut = (rng.uniform(0, 0.12), rng.choice([0.0, rng.uniform(0, 0.1)])) if loose else (0, 0)
    gauge, flat = rng.uniform(0.65, 0.85), []
    for k in range(25):
        across = half * (k / 12 - 1)
        deep = sunk * min(1.0, half - abs(across))
        deep += rut * max(0.0, 1 - abs(abs(across) - gauge) / 0.28)
        flat.append((across, 0.03 - deep))
    bumps = 0.04 * loose
    end = min(FAR, road.length)
    sweep(scene, road, flat, surfaces.road, road.truth, (0, end), kind.ragged, bumps)
    beyond = VOID if road.truth == ROAD else road.truth
    sweep(scene, road, flat, surfaces.road, beyond, (FAR - 1, road.length), bumps=bumps)
    if scene.chance({"track": 0.55, "trail": 0.1, "lane": 0.1}.get(road.name, 0)):
        wide = rng.uniform(0.15, 0.4)
        truth = HORIZONTAL if wide > 0.22 else VOID
        ridge = [(-wide, 0.0), (-wide, 0.06), (0, 0.1), (wide, 0.06), (wide, 0.0)]
        sweep(scene, road, ridge, surfaces.soil, truth, (0, END), 0.15)


# --- edges, from the carriageway outwards -------------------------------------------------

STRIPS = read_table("strips")
"""Strips beside the road: probability, width in metres, height over a kerb's, material, truth."""


def _build_edge(scene: Scene, road: Road, side: int, edge: str, surfaces: Surfaces) -> None:
    """Lay strips one beside another from the carriageway on, or build a rail or a barrier."""
    rng, below, bazaar = scene.rng, 0.03, road.name == "bazaar"
    out = _build_bays(scene, road, side, surfaces) if edge == "kerb" else road.course.half
    road.walks[side] = (out, out + 2, 0.05)
    for row in (row for row in STRIPS if row["edge"] == edge and scene.chance(row["chance"])):
        name, truth, ragged = row["strip"], row["truth"], 0.0
        if name == "cycle" and road.truth != ROAD:
            continue
        inner, out = out, out + scene.between(row["width"]) * (2 if bazaar else 1)
        if name == "walk" and (surfaces.grey or road.name == "tunnel"):
            out = inner + (0.7 if road.name == "tunnel" else rng.uniform(2.4, 3.8))
        up = max(surfaces.kerb * row["level"], 0.031)
        if name == "earth":
            material, up, ragged = ground(scene, materials.sample_soil(scene, "earth")), 0.012, 0.2
            truth = VOID if bazaar else truth  # for some people's labels it is road
        elif row["patterns"]:
            alike = surfaces.grey and name == "plaza"
            tones = [materials.sample_grey(scene)] if alike else row["colours"]
            material = pave(scene, sample_paving(scene, tones, row["patterns"]))
        else:
            material = getattr(surfaces, name)
        section = [(side * (inner - ragged), up), (side * out, up + 0.005)]
        if up - below > 0.004:
            section.insert(0, (side * inner, 0.0))
        sweep(scene, road, section, material, truth, None, ragged)
        below = up + 0.005
        road.walks[side] = (inner, out, below)
    if edge in ("rail", "barrier"):
        _build_rail(scene, road, side, edge)
    if road.name in (*MOTORWAYS, "tunnel"):
        out += rng.uniform(0.5, 3)
    road.ends[side] = out


def _build_bays(scene: Scene, road: Road, side: int, surfaces: Surfaces) -> float:
    """Build parking bays or a painted cycle lane, or park cars; return where the kerb is."""
    rng, half, near = scene.rng, road.course.half, side == scene.hand
    if scene.chance(road.kind.parked * (0.3 if near else 0.8)):  # bays, often of another paving
        wide, alike = rng.choice([2.0, 2.3, 4.6]), scene.chance(0.5)
        paving = sample_paving(scene, "paving", {"setts": 1, "asphalt": 1})
        bay = surfaces.road if alike else pave(scene, paving)
        section = [(side * half, 0.03), (side * (half + wide), 0.03)]
        sweep(scene, road, section, bay, ROAD if alike else VOID)
        road.parking[side] = (side * (half + wide / 2), 0.04)
        return half + wide
    if scene.chance(road.kind.parked * (0.4 if near else 1)):  # with two wheels on the pavement?
        beyond = rng.choice([-1.0, -0.9, 0.3, 1.1])
        road.parking[side] = (side * (half + beyond), surfaces.kerb if beyond > 0 else 0.04)
    elif road.kind.marks and half > 4 and scene.chance(0.25):
        line = [(side * (half - out), 0.036) for out in (rng.uniform(1.3, 2), 0.15)]
        sweep(scene, road, line, plain(scene, "cycle", 0.9, vary=0.4), ROAD, (0, FAR))
    return half


def _build_rail(scene: Scene, road: Road, side: int, edge: str) -> None:
    """Build a rail beyond the edge, or a barrier of concrete on it."""
    rng, a = scene.rng, side * road.course.half
    out, top = a + side * rng.uniform(0.1, 1.5), rng.uniform(0.7, 1.1)
    section = [(out, rng.choice([0.0, 0.5])), (out, 0.8), (out + 0.2 * side, 0.8)]
    if edge == "barrier":
        section = [(a, 0.0), (a + 0.15 * side, 0.3), (a + 0.2 * side, top)]
        section += [(a + 0.5 * side, top), (a + 0.5 * side, 0.0)]
    material = plain(scene, "concrete" if edge == "barrier" else "grey", 0.6)
    sweep(scene, road, section, material, VERTICAL, (0, END))


def _build_middle(scene: Scene, road: Road, split: float, bed: float, surfaces: Surfaces) -> None:
    """Build an island or a tram bed between the directions, or tracks in the road."""
    rng = scene.rng
    if bed:
        gravel = ground(scene, materials.sample_soil(scene, "paving")._replace(grain=12), 0.8)
        top, a = rng.choice([surfaces.soil, gravel, surfaces.walk]), bed / 2
        up = surfaces.kerb + 0.03
        for side in (-1, 1):
            rim = [(side * a, 0), (side * a, up), (side * (a - 0.15), up)]
            section = [(split + across, height) for across, height in rim]
            sweep(scene, road, section, surfaces.stone, HORIZONTAL)
        sweep(scene, road, [(split + 0.15 - a, up), (split + a - 0.15, up)], top, HORIZONTAL)
        tracks = [split - 1.6, split + 1.6] if bed > 5 else []
    else:
        up, beyond = 0.0, split - scene.hand * rng.uniform(1.4, 1.9)
        pairs = [[split - 1.55, split + 1.55], [beyond], [beyond]]
        tracks = rng.choice(pairs) if scene.chance(0.4) else []
    steel = plain(scene, (0.35, 0.34, 0.33), 0.25, metal=0.9)
    for middle in tracks:
        for rail in (middle - 0.72, middle + 0.72):
            line = [(rail - 0.05, up + 0.037), (rail + 0.05, up + 0.037)]
            sweep(scene, road, line, steel, HORIZONTAL if bed else ROAD, (0, FAR))
    road.tram = rng.choice(tracks) if tracks else None


REACH = 70  # length of a side street in metres


def _build_side_street(scene: Scene, road: Road, gap: Span, surfaces: Surfaces) -> None:
    """Build a street to the left, the right or both: carriageway, pavements, houses."""
    (low, high), rng, half = gap, scene.rng, road.course.half
    opened = rng.choices([(-scene.hand,), (scene.hand,), (-1, 1)], (4, 2, 4))[0]
    walk = (surfaces.walk, HORIZONTAL)
    for side in (-1, 1):
        edge, up, wide = road.ends[side], max(surfaces.kerb, 0.031), rng.uniform(1.0, 1.9)
        if side not in opened:
            _build_slab(scene, road, gap, (side * half, side * edge), up, walk)
            continue
        across = (side * half * 0.9, side * REACH)
        _build_slab(scene, road, gap, across, 0.028, (surfaces.road, ROAD))
        if "kerb" not in road.kind.edges:
            continue
        across = (side * (edge - 0.05), side * REACH)
        for span in ((low + 0.02 - wide, low + 0.02), (high - 0.02, high - 0.02 + wide)):
            _build_slab(scene, road, span, across, up + 0.009, walk)
        for index in (low - 4, high + 4):  # houses at the corners, and where the street ends
            build_block(scene, road, index, side * (edge + 24), (46.0, 6.5))
        build_block(scene, road, (low + high) // 2, side * (REACH + 4), (8.0, 40.0))


def _build_slab(
    scene: Scene, road: Road, span: Limits, across: Limits, up: float, top: tuple[Material, int]
) -> None:
    """Build a slab between two points of the course and two offsets across it, up to a height."""
    corners = [(index, out) for index in span for out in across]
    points = [road.course.position(*corner, z) for z in (up, up - 0.25) for corner in corners]
    faces = [(0, 1, 3, 2), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    scene.put_surface(points, faces, *top)


def build_block(scene: Scene, road: Road, index: int, across: float, size: Limits) -> None:
    """Build a house of some metres across and along the main road."""
    tall = scene.rng.uniform(5, 20)
    mesh = scene.mesh([(box((0, 0, tall / 2 - 2), (*size, tall + 4)), materials.facade(scene))])
    position = road.course.position(index, across)
    scene.put(mesh, VERTICAL, position, -road.course.heading(index))


def _build_land(scene: Scene, road: Road, soil: Material) -> None:
    """Build the land on both sides, flat, then banks, ditches and hills; and a plain below."""
    rng, half = scene.rng, road.course.half
    steps = [0, 0.5, 1, 1.8, 3, 5, 8, 12, 18, 27, 40, 60, 90]
    level = bool(road.gaps) or road.kind.sides.keys() & {"terrace", "shops"}
    for side in (-1, 1):
        slope = 0.0 if level else rng.choice([0.0, 0.0, -0.25, 0.15, 0.5])
        flat, most, end = rng.uniform(0.5, 4), rng.uniform(2, 7), road.ends[side]
        rises = [(float(step), slope * min(max(step - flat, 0), most)) for step in steps]
        road.rises[side] = rises
        section = [(side * (end + step), up - 0.03 * bool(level)) for step, up in rises]
        bumps = 0.0 if level else 0.06 + 0.1 * abs(slope)
        sweep(scene, road, section, soil, HORIZONTAL, (0, END), bumps=bumps)
        inner = half - 0.45 if road.name in NARROW else 0.0  # those may be sunken
        under = [(side * inner, -0.02), (side * (end + 0.6), -0.02 - 0.02 * bool(level))]
        sweep(scene, road, under, soil, HORIZONTAL, (0, END))
    below = min(point.z for point in road.course.points) - (0.3 if level else 1.5)
    scene.put_plane(900, below, soil, HORIZONTAL)
