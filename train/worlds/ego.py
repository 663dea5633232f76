"""The vehicle that carries the camera, as the camera sees it: car, robot, motorcycle, bicycle.

Parts are in the camera's axes: x right, y up, z back.
"""

from math import cos, sin
from typing import Any, NamedTuple

from train.worlds.figures import build_thing
from train.worlds.materials import plain, sample_colour
from train.worlds.scene import Material, Parts, Point, Scene, Shape
from train.worlds.shapes import box, stretch
from train.worlds.truth import EGO


class Lens(NamedTuple):
    """Tangents of half the vertical (half_up) and horizontal (half_across) field of view."""

    half_up: float
    half_across: float

    def row(self, edge: float, deep: float) -> float:
        """Return the height at a depth that is at a fraction of the image from below."""
        return -(1 - 2 * edge) * self.half_up * deep


def put_body(scene: Scene, camera: Any, lens: Lens, mount: str) -> None:
    """Add what is in view of the vehicle of a mount."""
    build = {"robot": _robot, "motorcycle": _rider, "bicycle": _rider}.get(mount, _car)
    for parts in build(scene, lens, mount):
        scene.put(scene.mesh(parts, smooth=len(parts) == 1), EGO).parent = camera


def _hull(lens: Lens, edge: float, deep: float, arch: float, swell: float, lean: float) -> Shape:
    """Return a surface below the camera whose far edge is at a fraction of the height from below.

    edge: the fraction; deep: metres to the far edge; arch: how much lower it is at its ends; swell:
    how much it rises between; lean: how much nearer the far edge is at its ends.
    """
    low, wide = lens.row(edge, 1.0), lens.half_across * deep * 1.5
    near, columns, rows = 0.25 * deep, 33, 14
    points, faces = [], []
    for k in range(rows):
        along = min(k / (rows - 3), 1.0)
        for j in range(columns):
            u = 2 * j / (columns - 1) - 1
            ahead = near + (deep * (1 - lean * u * u) - near) * along
            drop = arch * deep * abs(u) ** 2.5 + 0.02 * (1 - along) + 0.5 * max(k - rows + 3, 0)
            points.append((u * wide, low * deep + swell * (1 - along) * along - drop, -ahead))
            if j and k:
                a = k * columns + j
                faces.append((a - 1, a, a - columns, a - columns - 1))
    return points, faces


def _car(scene: Scene, lens: Lens, mount: str) -> list[Parts]:
    """Return a bonnet that reflects the road, a dashboard, or a strip of one above the other."""
    rng, bodies = scene.rng, []
    weights = (1, 5, 1) if mount == "truck" else (6, 3, 2)
    kind = rng.choices(["bonnet", "dashboard", "both"], weights)[0]
    edge = rng.uniform(0.03, 0.3) if kind == "bonnet" else rng.uniform(0.08, 0.4)
    if kind != "dashboard":
        paint = _paint(scene)
        deep, arch = rng.uniform(1.1, 2.0), rng.uniform(0.0, 0.35)
        hull = _hull(lens, edge, deep, arch, rng.uniform(0, 0.12), rng.uniform(0, 0.25))
        bodies.append([(hull, paint)])
    if kind != "bonnet":
        if kind == "both":
            edge -= rng.uniform(0.02, 0.08)
        dark = plain(scene, "dark", rng.uniform(0.3, 0.9))
        deep, arch = rng.uniform(0.45, 0.8), rng.uniform(0, 0.1)
        hull = _hull(lens, edge, deep, arch, rng.uniform(0, 0.03), rng.uniform(0, 0.2))
        parts: Parts = [(hull, dark)]
        for _ in range(rng.choice([0, 0, 1, 2])):  # a telephone, a hood over the instruments
            across, up = rng.uniform(-0.9, 0.9) * lens.half_across, lens.row(edge, 0.6)
            size = (rng.uniform(0.04, 0.25), rng.uniform(0.02, 0.07), 0.05)
            parts.append((box((across * 0.6, up, -0.6), size), dark))
        bodies.append(parts)
    if scene.chance(0.15):  # a pillar of the windscreen, upright or leaning
        side = rng.choice((-1, 1))
        out, lean = side * lens.half_across * rng.uniform(0.35, 0.5), side * rng.uniform(0, 0.6)
        lean, wide = lean * lens.half_up, side * 0.6
        points = [(out, -0.5, -0.5), (out + wide, -0.5, -0.5)]
        points += [(out + wide + lean, 0.5, -0.5), (out + lean, 0.5, -0.5)]
        bodies.append([((points, [(0, 1, 2, 3)]), _paint(scene))])
    return bodies


def _paint(scene: Scene) -> Material:
    """Return glossy to matt paint, metallic or not."""
    rng = scene.rng
    colour, rough = sample_colour(scene, "paint dark"), rng.choice([0.03, 0.12, 0.4, 0.8])
    return plain(scene, colour, rough, rng.choice([0.0, 0.4]), 0.03)


def _robot(scene: Scene, lens: Lens, mount: str) -> list[Parts]:
    """Return the front of a robot at the lower edge: a plate or a bar."""
    rng = scene.rng
    up, wide = lens.row(rng.uniform(0.02, 0.16), 0.3), lens.half_across * rng.uniform(0.2, 0.8)
    plate = box((rng.uniform(-0.1, 0.1), up - 0.1, -0.3), (wide, 0.2, 0.1))
    return [[(plate, plain(scene, "paint", rng.uniform(0.2, 0.8)))]]


def _rider(scene: Scene, lens: Lens, mount: str) -> list[Parts]:
    """Return handlebar, arms, mirrors and wheel, or a fairing over up to half of the image.

    Things of riders are built about the middle of the handlebar.
    """
    rng, motor = scene.rng, mount == "motorcycle"
    edge, deep = rng.uniform(0.04, 0.46 if motor else 0.4), rng.uniform(0.45, 0.8)
    low, lean = lens.row(edge, deep), rng.gauss(0, 0.08)
    parts, _ = build_thing(scene, "motorcycle" if motor else "bicyclebar")
    if scene.chance(0.8):
        wide, reach = (1.15 if motor else 0.95) * rng.uniform(0.9, 1.1), deep / 0.6
        rise = rng.uniform(-0.2, 0.6)  # of the elbows, towards the camera
        for (points, faces), material in build_thing(scene, "arms")[0]:
            bent = [(x * wide, y * reach, z - min(0.0, y + 0.12) * rise) for x, y, z in points]
            parts.append(((bent, faces), material))

    def place(point: Point) -> Point:
        x, y, z = point
        return (x * cos(lean) - z * sin(lean), low + x * sin(lean) + z * cos(lean), -deep - y)

    bodies: list[Parts] = []
    for (points, faces), material in parts:
        bodies.append([(([place(point) for point in points], faces), material)])
    if motor and scene.chance(0.45):  # a fairing, an apron
        edge = min(0.5, edge + rng.uniform(-0.08, 0.06))
        arch, lean_back = rng.uniform(0.2, 0.8), rng.uniform(0.1, 0.7)
        hull = _hull(lens, edge, deep + rng.uniform(0.1, 0.4), arch, 0.05, lean_back)
        bodies.append([(stretch(hull, (rng.uniform(0.3, 0.8), 1, 1)), _paint(scene))])
    return bodies
