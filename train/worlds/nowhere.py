"""Images without road: rooms, table tops, walls, fields and water.

They teach that an image need not have a road. Floors, fields and water are ground; whatever stands
on them is vertical.
"""

from math import atan, cos, sin, sqrt
from typing import Any

import bpy
from mathutils import Vector

from train.worlds.camera import sample_lens
from train.worlds.materials import (
    Colour,
    Nodes,
    drawn,
    facade,
    finished,
    ground,
    lamp,
    new_surface,
    palette,
    paved,
    plain,
    slabs,
)
from train.worlds.people import person
from train.worlds.roads import EARTHS, GREENS, LITTER, PAVINGS, SNOW
from train.worlds.stage import Material, Point, Stage, box, loose, turned
from train.worlds.surroundings import WALLS, crown
from train.worlds.truth import HORIZONTAL, VERTICAL

PLACES = ("room", "things", "wall", "field", "water")

INDOORS = palette("60 55 48, 50 50 52, 30 20 12, 70 70 66, 20 25 35, 45 12 8, 10 20 12, 5 5 5")


def build_nowhere(stage: Stage) -> str:
    """Build one of the places with its camera; return its kind."""
    kind = stage.at.choice(PLACES)
    data: Any = bpy.data.cameras.new("camera")
    data.sensor_fit, data.clip_start, data.clip_end = "VERTICAL", 0.02, 2000
    data.angle_y = 2 * atan(sample_lens(stage).half_up)
    builders = {"room": _room, "things": _things, "wall": _wall, "field": _field, "water": _water}
    where, target = builders[kind](stage)
    camera = stage.add("camera", data, where)
    gaze = Vector(target) - Vector(where)
    camera.rotation_euler = gaze.to_track_quat("-Z", "Y").to_euler()
    camera.rotation_euler.rotate_axis("Z", stage.at.gauss(0, 0.05))
    stage.scene.camera = camera
    return kind


def _any_surface(stage: Stage) -> Material:
    """Sample a surface: plain, patched, tiled, of stones, printed."""
    at, colours = stage.at, INDOORS + PAVINGS
    first, second = drawn(stage, colours, 0.5), drawn(stage, colours, 0.5)
    kind = at.choice(["plain", "ground", "slabs", "stones", "printed"])
    if kind == "plain":
        return plain(stage, first, at.uniform(0.1, 0.9))
    if kind == "ground":
        return ground(stage, first, second, at.uniform(1, 60), at.uniform(0.1, 0.8))
    if kind == "slabs":
        return slabs(stage, first, at.uniform(0.05, 0.8))
    if kind == "stones":
        return paved(stage, first, 99, 0.0, at.uniform(0.05, 0.5))
    return _printed(stage, first, second)


def _printed(stage: Stage, first: Colour, second: Colour) -> Material:
    """Return stripes, checks or rings of two colours."""
    nodes, at = new_surface(), stage.at
    scale = at.uniform(1, 20)
    kinds = {"ShaderNodeTexChecker": "Fac", "ShaderNodeTexWave": "Fac", "ShaderNodeTexVoronoi": 0}
    kind = at.choice(list(kinds))
    share = nodes.add(kind, {"Vector": nodes.place(), "Scale": scale}, kinds[kind])
    return finished(stage, nodes, nodes.mix(share, tuple(first), tuple(second)), 0.7)


def _plane(stage: Stage, look: Material, size: float, truth: int) -> None:
    corners = [(x * size, y * size, 0.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    mesh = stage.mesh([((corners, [(0, 1, 2, 3)]), look)])
    mesh.uv_layers.new(name="UV")
    stage.put(mesh, truth)


def _thing(stage: Stage, size: float) -> Any:
    """Return a box, a vessel, a ball or leaves of about a size."""
    at, look = stage.at, _any_surface(stage)
    kind = at.choice(["box", "box", "vessel", "ball", "leaves"])
    if kind == "box":
        a, b, c = (size * at.uniform(0.2, 1) for _ in range(3))
        return stage.mesh([(box((0, 0, c / 2), (a, b, c)), look)])
    if kind == "leaves":
        points, faces = crown(stage, 300, 0.15)
        shape = [(x * size, y * size, (z + 1) * size) for x, y, z in points]
        return stage.mesh([((shape, faces), look)])
    rows = [k / 8 for k in range(9)]
    widths = [at.uniform(0.1, 0.5) for _ in rows]
    if kind == "ball":
        widths = [sqrt(max(0.001, 0.25 - (row - 0.5) ** 2)) for row in rows]
    profile = [(size * width, size * row) for row, width in zip(rows, widths, strict=True)]
    return stage.mesh([(turned(profile, 16), look)], smooth=True)


def _scatter(stage: Stage, count: int, size: float, reach: float, near: float = 0.0) -> None:
    """Scatter objects on the ground, from ``near`` to ``reach`` metres ahead."""
    at = stage.at
    for _ in range(count):
        where = (at.uniform(-reach, reach), at.uniform(near, reach), 0.0)
        stage.put(_thing(stage, size * at.uniform(0.3, 1)), VERTICAL, where, at.uniform(0, 6))


def _room(stage: Stage) -> tuple[Point, Point]:
    at = stage.at
    wide, deep, tall = at.uniform(1.2, 6), at.uniform(3, 14), at.uniform(2.3, 4)
    floor, wall, roof = (_any_surface(stage) for _ in range(3))
    points = [(x, y, 0.0) for x, y in ((-wide, -2), (wide, -2), (wide, deep), (-wide, deep))]
    mesh = stage.mesh([((points, [(0, 1, 2, 3)]), floor)])
    mesh.uv_layers.new(name="UV")
    stage.put(mesh, HORIZONTAL)
    points += [(x, y, tall) for x, y, _ in points]
    sides = stage.mesh([((points, [(1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (0, 1, 5, 4)]), wall)])
    stage.put(sides, VERTICAL)
    stage.put(stage.mesh([((points, [(4, 5, 6, 7)]), roof)]), VERTICAL)
    for _ in range(at.choice([1, 2, 4])):
        middle = (at.uniform(-0.7, 0.7) * wide, at.uniform(0.5, deep - 1), tall - 0.02)
        shade = box(middle, (at.uniform(0.3, 1.2), at.uniform(0.3, 1.2), 0.03))
        stage.put(stage.mesh([(shade, lamp((1, 0.9, 0.75), at.uniform(8, 40)))]), VERTICAL)
    for _ in range(at.randint(2, 12)):
        where = (at.uniform(-1, 1) * wide, at.uniform(1.5, deep), 0.0)
        stage.put(_thing(stage, at.uniform(0.3, 2)), VERTICAL, where, at.uniform(0, 6))
    if stage.chance(0.3):
        stage.put(stage.mesh(person(stage)), VERTICAL, (at.uniform(-1, 1), at.uniform(2, deep), 0))
    where = (at.uniform(-0.5, 0.5) * wide, -1.5, at.uniform(0.3, 2.0))
    return where, (at.gauss(0, 1.0), 3.0, at.uniform(0.2, 1.8))


def _things(stage: Stage) -> tuple[Point, Point]:
    """Build a table top or another support of objects, seen from above or obliquely."""
    at = stage.at
    _plane(stage, _any_surface(stage), 4, at.choice([VERTICAL, HORIZONTAL]))
    size = at.uniform(0.05, 0.4)
    _scatter(stage, at.choice([1, 3, 12, 30]), size, at.uniform(2, 6) * size, -3 * size)
    far = at.uniform(3, 8) * size
    tilt = at.uniform(0.3, 1.5)
    return (at.gauss(0, size), -far * cos(tilt), far * sin(tilt) + 0.05), (0.0, 0.0, size * 0.3)


def _wall(stage: Stage) -> tuple[Point, Point]:
    """Build a facade, a page or a fabric that fills the image."""
    at, half = stage.at, stage.at.uniform(0.5, 15)
    look = facade(stage, drawn(stage, WALLS)) if half > 3 else _any_surface(stage)
    stage.put(stage.mesh([(box((0, 6, 0), (6 * half, 0.5, 6 * half)), look)]), VERTICAL)
    if stage.chance(0.5):
        _scatter_up(stage, at.choice([2, 9]), half)
    return (at.gauss(0, half / 3), 5 - half * at.uniform(0.5, 1.2), 0.0), (0.0, 6.0, at.gauss(0, 1))


def _scatter_up(stage: Stage, count: int, half: float) -> None:
    """Scatter objects in front of a wall."""
    at = stage.at
    for _ in range(count):
        where = (at.uniform(-1, 1) * half, 5.3, at.uniform(-1, 1) * half)
        stage.put(_thing(stage, half * at.uniform(0.1, 0.5)), VERTICAL, where, at.uniform(0, 6))


def _field(stage: Stage) -> tuple[Point, Point]:
    """Build a meadow, crop, earth, sand or snow with plants and without a way."""
    at = stage.at
    colours = at.choice([GREENS, GREENS, EARTHS, LITTER, SNOW])
    soil = ground(stage, drawn(stage, colours), drawn(stage, colours), at.uniform(0.5, 9), 0.5)
    _plane(stage, soil, 600, HORIZONTAL)
    leaf = ground(stage, drawn(stage, GREENS, 0.4), drawn(stage, GREENS, 0.4), 3, 0.3, 0)
    bush = stage.mesh([(crown(stage, 700, 0.2), leaf)])
    for _ in range(at.choice([0, 8, 60])):
        size = at.uniform(0.3, 4)
        where = (at.gauss(0, 20), at.uniform(4, 90), size * 0.6)
        stage.put(bush, VERTICAL, where, at.uniform(0, 6), (size, size, size))
    _tufts(stage)
    tall = at.uniform(0.4, 3)
    return (0.0, 0.0, tall), (at.gauss(0, 3), 10.0, tall - at.uniform(0, 3.5))


def _tufts(stage: Stage) -> None:
    """Scatter tufts of blades."""
    at = stage.at
    blade, points = plain(stage, drawn(stage, GREENS + LITTER, 0.35), 0.8, vary=0.5), []
    tall = at.uniform(0.05, 0.9)
    for _ in range(160):
        x, y, turn = at.uniform(-0.6, 0.6), at.uniform(-0.6, 0.6), at.uniform(0, 6.28)
        dx, dy, high = 0.025 * cos(turn), 0.025 * sin(turn), at.uniform(0.3, 1) * tall
        points += [(x + dx, y + dy, 0), (x - dx, y - dy, 0), (x + at.gauss(0, 0.1), y, high)]
    mesh = stage.mesh([(loose(points), blade)])
    for _ in range(at.choice([0, 400, 1200])):
        where = (at.gauss(0, 9), 1.5 + at.expovariate(0.08), 0.0)
        stage.put(mesh, HORIZONTAL, where, at.uniform(0, 6))


def _water(stage: Stage) -> tuple[Point, Point]:
    """Build a lake or the sea with its far shore."""
    at, nodes = stage.at, Nodes(bpy.data.materials.new("water"))
    tone = drawn(stage, palette("2 4 5, 4 6 5, 8 9 8"))
    waves = nodes.bump(nodes.noise(at.uniform(0.3, 4)), at.uniform(0.05, 0.6), 0.1)
    look = finished(stage, nodes, nodes.mix(0.5, tone, tone), 0.05, {"Normal": waves})
    _plane(stage, look, 700, HORIZONTAL)
    leaf = ground(stage, drawn(stage, GREENS, 0.4), drawn(stage, GREENS, 0.4), 0.4, 0.3, 0)
    bush, far = stage.mesh([(crown(stage, 700, 0.2), leaf)]), at.uniform(20, 200)
    for _ in range(at.choice([0, 40])):
        size = far * at.uniform(0.03, 0.09)
        where = (at.uniform(-2, 2) * far, far + at.uniform(0, 9), size * 0.5)
        stage.put(bush, VERTICAL, where, at.uniform(0, 6), (size * 1.5, size, size))
    tall = at.uniform(0.5, 5)
    return (0.0, 0.0, tall), (at.gauss(0, 3), 10.0, tall - at.uniform(-0.5, 3))
