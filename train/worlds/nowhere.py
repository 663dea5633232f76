"""Places without road: rooms, table tops, walls, fields and water.

They teach that an image need not have a road. Floors, fields and water are ground; whatever stands
on them is vertical.
"""

from collections.abc import Callable
from math import atan, cos, sin, sqrt
from typing import Any

from train.worlds import materials
from train.worlds.blender import Vector, bpy
from train.worlds.camera import sample_lens
from train.worlds.materials import finish, ground, new_surface, plain, sample_colour, sample_soil
from train.worlds.scene import Material, Point, Scene
from train.worlds.shapes import box, revolve
from train.worlds.sides import crown, sample_leaf, tuft
from train.worlds.truth import HORIZONTAL, VERTICAL

FACES = {"floor": [(0, 1, 2, 3)], "ceiling": [(4, 5, 6, 7)]}
FACES["walls"] = [(1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (0, 1, 5, 4)]


def build_place(scene: Scene, name: str) -> None:
    """Build a place with its camera."""
    data: Any = bpy.data.cameras.new("camera")
    data.sensor_fit, data.clip_start, data.clip_end = "VERTICAL", 0.02, 2000
    data.angle_y = 2 * atan(sample_lens(scene).half_up)
    position, target = PLACES[name](scene)
    camera = scene.blender.camera = scene.add("camera", data, position)
    gaze = Vector(target) - Vector(position)
    camera.rotation_euler = gaze.to_track_quat("-Z", "Y").to_euler()
    camera.rotation_euler.rotate_axis("Z", scene.rng.gauss(0, 0.05))


def _sample_surface(scene: Scene) -> Material:
    """Sample a surface: plain, patched, paved, printed with stripes, checks or rings."""
    rng, colours = scene.rng, "indoors paving"
    first, second = sample_colour(scene, colours, 0.5), sample_colour(scene, colours, 0.5)
    kind = rng.choice(["plain", "ground", "paved", "paved", "Checker", "Wave", "Voronoi"])
    if kind == "plain":
        return plain(scene, first, rng.uniform(0.1, 0.9))
    if kind == "ground":
        return ground(scene, sample_soil(scene, colours)._replace(grain=rng.uniform(1, 60)))
    if kind == "paved":
        patterns = {"slabs": 2, "setts": 1, "cobbles": 1}
        return materials.pave(scene, materials.sample_paving(scene, [first], patterns))
    nodes = new_surface()
    inputs = {"Vector": nodes.position(), "Scale": rng.uniform(1, 20)}
    fraction = nodes.add(f"ShaderNodeTex{kind}", inputs, 0 if kind == "Voronoi" else "Fac")
    return finish(scene, nodes, nodes.mix(fraction, first, second), 0.7)


def _scatter(
    scene: Scene, count: int, size: float, low: Point, high: Point, leaf: Material = None
) -> None:
    """Scatter boxes, vessels, balls and leaves (or bushes of a leaf) of about a size in a box."""
    rng, rows = scene.rng, [k / 8 for k in range(9)]
    for _ in range(count):
        material, big = leaf or _sample_surface(scene), size * rng.uniform(0.2, 1)
        kind = "leaves" if leaf else rng.choice(["box", "box", "vessel", "ball", "leaves"])
        widths = [rng.uniform(0.1, 0.5) for _ in rows]
        if kind == "box":
            shape = box((0, 0, big / 2), (big, size * rng.uniform(0.2, 1), big))
        elif kind == "leaves":
            points, faces = crown(scene, 300)
            shape = [(x * big, y * big, (z + 1) * big) for x, y, z in points], faces
        else:
            if kind == "ball":
                widths = [sqrt(max(0.001, 0.25 - (row - 0.5) ** 2)) for row in rows]
            shape = revolve([(big * w, big * row) for row, w in zip(rows, widths, strict=True)], 16)
        mesh = scene.mesh([(shape, material)], kind in ("vessel", "ball"))
        x, y, z = (rng.uniform(*limits) for limits in zip(low, high, strict=True))
        scene.put(mesh, VERTICAL, (x, y, z), rng.uniform(0, 6))


def _build_room(scene: Scene) -> tuple[Point, Point]:
    rng, between = scene.rng, scene.rng.uniform
    wide, deep, tall = between(1.2, 6), between(3, 14), between(2.3, 4)
    points = [(x, y, 0.0) for x, y in ((-wide, -2), (wide, -2), (wide, deep), (-wide, deep))]
    points += [(x, y, tall) for x, y, _ in points]
    for name, faces in FACES.items():
        truth = HORIZONTAL if name == "floor" else VERTICAL
        scene.put_surface(points, faces, _sample_surface(scene), truth)
    for _ in range(rng.choice([1, 2, 4])):
        middle = (between(-0.7, 0.7) * wide, between(0.5, deep - 1), tall - 0.02)
        shade = box(middle, (between(0.3, 1.2), between(0.3, 1.2), 0.03))
        scene.put(scene.mesh([(shade, materials.lamp((1, 0.9, 0.75), between(8, 40)))]), VERTICAL)
    _scatter(scene, rng.randint(2, 12), between(0.4, 2), (-wide, 1.5, 0), (wide, deep, 0))
    position = (between(-0.5, 0.5) * wide, -1.5, between(0.3, 2.0))
    return position, (rng.gauss(0, 1.0), 3.0, between(0.2, 1.8))


def _build_things(scene: Scene) -> tuple[Point, Point]:
    """Build a table top or another support of objects, seen from above or obliquely."""
    rng, size = scene.rng, scene.rng.uniform(0.05, 0.4)
    scene.put_plane(4, 0, _sample_surface(scene), rng.choice([VERTICAL, HORIZONTAL]))
    reach, count = rng.uniform(2, 6) * size, rng.choice([1, 3, 12, 30])
    _scatter(scene, count, size, (-reach, -3 * size, 0), (reach, reach, 0))
    far, tilt = rng.uniform(3, 8) * size, rng.uniform(0.3, 1.5)
    return (rng.gauss(0, size), -far * cos(tilt), far * sin(tilt) + 0.05), (0, 0, size * 0.3)


def _build_wall(scene: Scene) -> tuple[Point, Point]:
    """Build a facade, a page or a fabric that fills the image."""
    rng, half = scene.rng, scene.rng.uniform(0.5, 15)
    material = materials.facade(scene) if half > 3 else _sample_surface(scene)
    scene.put(scene.mesh([(box((0, 6, 0), (6 * half, 0.5, 6 * half)), material)]), VERTICAL)
    _scatter(scene, rng.choice([0, 0, 2, 9]), half / 2, (-half, 5.3, -half), (half, 5.3, half))
    return (rng.gauss(0, half / 3), 5 - half * rng.uniform(0.5, 1.2), 0.0), (0, 6, rng.gauss(0, 1))


def _build_field(scene: Scene) -> tuple[Point, Point]:
    """Build a meadow, crop, earth, sand or snow with plants and without a way."""
    rng, tall = scene.rng, scene.rng.uniform(0.4, 3)
    soil = sample_soil(scene, rng.choice(["green", "green", "earth", "litter", "snow"]))
    leaves = rng.choice([0.0, 0.0, rng.uniform(0.2, 1)])
    scene.put_plane(600, 0, ground(scene, soil._replace(leaves=leaves)), HORIZONTAL)
    _scatter(scene, rng.choice([0, 8, 40]), 4, (-40, 4, 0), (40, 90, 0), sample_leaf(scene))
    mesh = tuft(scene, "green litter", rng.uniform(0.05, 0.9), 0.6)
    for _ in range(rng.choice([0, 400, 1200])):
        position = (rng.gauss(0, 9), 1.5 + rng.expovariate(0.08), 0.0)
        scene.put(mesh, HORIZONTAL, position, rng.uniform(0, 6))
    return (0.0, 0.0, tall), (rng.gauss(0, 3), 10.0, tall - rng.uniform(0, 3.5))


def _build_water(scene: Scene) -> tuple[Point, Point]:
    """Build a lake or the sea with its far shore."""
    rng, nodes, tall = scene.rng, new_surface(), scene.rng.uniform(0.5, 5)
    tone, far = sample_colour(scene, "water"), rng.uniform(20, 200)
    waves = nodes.bump(nodes.noise(rng.uniform(0.3, 4)), rng.uniform(0.05, 0.6), 0.1)
    scene.put_plane(700, 0, finish(scene, nodes, (*tone, 1), 0.05, Normal=waves), HORIZONTAL)
    shore = (-2 * far, far, 0), (2 * far, far + 9, 0)
    _scatter(scene, rng.choice([0, 40]), far / 10, *shore, sample_leaf(scene))
    return (0.0, 0.0, tall), (rng.gauss(0, 3), 10.0, tall - rng.uniform(-0.5, 3))


PLACES: dict[str, Callable[[Scene], tuple[Point, Point]]] = {
    **{"room": _build_room, "things": _build_things, "wall": _build_wall},
    **{"field": _build_field, "water": _build_water},
}
"""Places, each built by a function that returns the camera's position and what it is aimed at."""
