"""People on foot, on bicycles, with prams and dogs; limbs, tyres and tubes have true thickness."""

from collections.abc import Callable
from math import cos, pi, sin
from typing import Any, NamedTuple

from mathutils import Vector

from train.worlds.materials import drawn, palette, plain
from train.worlds.stage import Material, Parts, Point, Shape, Stage, box, moved, turned
from train.worlds.truth import VERTICAL, VOID

SKIN = palette("40 25 18, 20 10 6, 10 5 3")

WHEEL = 0.34
"""Radius of a bicycle's wheel in metres."""


class Figure(NamedTuple):
    """A person at the origin who faces y.

    veil: see-through parts that nobody labels as road, as between spokes; void in the truth.
    """

    parts: Parts
    veil: Parts


def limb(start: Point, end: Point, radius: float, last: float, sides: int = 6) -> Shape:
    """Return a tube between two points that tapers from one radius to another."""
    axis = Vector(end) - Vector(start)
    across = axis.orthogonal().normalized()
    other = axis.cross(across).normalized()
    points: list[Point] = []
    for middle, wide in ((start, radius), (end, last)):
        for k in range(sides):
            turn = 2 * pi * k / sides
            out = Vector(middle) + wide * (cos(turn) * across + sin(turn) * other)
            points.append((out.x, out.y, out.z))
    faces: list[list[int]] = [
        [k, (k + 1) % sides, sides + (k + 1) % sides, sides + k] for k in range(sides)
    ]
    return points, [*faces, list(range(sides)), list(range(sides, 2 * sides))]


def tyre(y: float, radius: float, thick: float, sides: int = 20) -> Shape:
    """Return an open ring in the plane x = 0 that stands on z = 0."""
    points: list[Point] = []
    for k in range(sides):
        turn = 2 * pi * k / sides
        for across, out in ((-thick, 0.0), (0.0, thick), (thick, 0.0), (0.0, -thick)):
            reach = radius - thick + out
            points.append((across, y + reach * cos(turn), radius + reach * sin(turn)))
    ring = [(k, (k + 1) % 4) for k in range(4)]
    faces = [
        [4 * k + a, 4 * k + b, 4 * ((k + 1) % sides) + b, 4 * ((k + 1) % sides) + a]
        for k in range(sides)
        for a, b in ring
    ]
    return points, faces


def scaled(shape: Shape, by: Point) -> Shape:
    """Return a shape stretched along the axes."""
    return [(x * by[0], y * by[1], z * by[2]) for x, y, z in shape[0]], shape[1]


def _cloth(stage: Stage) -> Material:
    at = stage.at
    bright = at.choice((0.05, 0.2, 0.6))
    return plain(stage, [at.uniform(0.01, bright) for _ in range(3)], 0.9)


def _leg(hip: Point, knee: Point, ankle: Point) -> list[Shape]:
    """Return thigh, shin and foot."""
    x, y, z = ankle
    foot = box((x, y + 0.07, max(z - 0.03, 0.04)), (0.09, 0.26, 0.08))
    return [limb(hip, knee, 0.085, 0.055), limb(knee, ankle, 0.055, 0.036), foot]


def _head(y: float, z: float) -> Shape:
    profile = [(0.05, 0.0), (0.095, 0.08), (0.1, 0.17), (0.06, 0.25), (0.01, 0.27)]
    points, faces = turned(profile, 8)
    return [(x, y + along, z + up) for x, along, up in points], faces


def _torso(waist: Point, neck: Point, stout: float) -> Shape:
    points, faces = limb(waist, neck, 0.15 * stout, 0.19 * stout, 8)
    middle = (waist[1] + neck[1]) / 2
    return [(x, middle + (y - middle) * 0.8, z) for x, y, z in points], faces


def person(stage: Stage) -> Parts:
    """Return a walking or standing person of any height, in trousers, a skirt or a coat."""
    at = stage.at
    tall = at.uniform(0.55, 0.8) if stage.chance(0.15) else at.uniform(0.88, 1.1)
    stout, stride = at.uniform(0.8, 1.25), at.choice([0.0, 0.1, at.uniform(0.2, 0.36)])
    below, above, skin = _cloth(stage), _cloth(stage), plain(stage, drawn(stage, SKIN), 0.7)
    shapes: Parts = []
    for side in (-1, 1):
        y, hip = side * stride, (side * 0.09, 0.0, 0.92)
        knee, ankle = (side * 0.095, 0.5 * y + 0.05 * (stride > 0), 0.5), (side * 0.09, y, 0.08)
        shapes += [(shape, below) for shape in _leg(hip, knee, ankle)]
        shoulder, elbow = (side * 0.2, 0.0, 1.4), (side * 0.25, -0.3 * y, 1.13)
        hand = (side * 0.24, -0.7 * y + 0.06, 0.87)
        shapes.append((limb(shoulder, elbow, 0.05 * stout, 0.042), above))
        shapes.append((limb(elbow, hand, 0.042, 0.03), stage.at.choice((above, skin))))
    shapes.append((_torso((0, 0, 0.88), (0, 0.02, 1.46), stout), above))
    shapes.append((_head(0.03, 1.46), skin))
    if stage.chance(0.3):  # a coat or a skirt
        hem = turned([(0.24, at.uniform(0.4, 0.75)), (0.17 * stout, 1.0)], 8)
        shapes.append((scaled(hem, (1, 0.8, 1)), at.choice((above, below))))
    if stage.chance(0.3):  # a bag in the hand or on the back
        middle = at.choice([(0.3, 0.0, 0.6), (-0.3, 0.05, 0.55), (0.0, -0.2, 1.2)])
        shapes.append((box(middle, (0.14, 0.2, 0.38)), _cloth(stage)))
    if stage.chance(0.5 if stage.falling else 0.02):
        cover = turned([(0.55, 1.95), (0.35, 2.1), (0.01, 2.18)], 10)
        shapes.append((moved(cover, (0.2, 0.1, 0)), _cloth(stage)))
        shapes.append((limb((0.2, 0.1, 1.1), (0.2, 0.1, 2.0), 0.012, 0.012), below))
    return [(scaled(shape, (tall, tall, tall)), look) for shape, look in shapes]


def rider(stage: Stage, seat: float, bar: Point, pedal: float) -> Parts:
    """Return a person sitting at a height who holds a bar (across, along, up)."""
    above, below = _cloth(stage), _cloth(stage)
    skin = plain(stage, drawn(stage, SKIN), 0.7)
    neck = (0.0, -0.2 + stage.at.uniform(0.1, 0.4) * bar[1], seat + 0.52)
    parts: Parts = []
    for side, low in ((-1, pedal), (1, pedal + 0.3 * stage.at.random())):
        hip, ankle = (side * 0.1, -0.18, seat), (side * 0.12, 0.0, low)
        knee = (side * 0.13, 0.2, (seat + low) / 2 + 0.12)
        parts += [(shape, below) for shape in _leg(hip, knee, ankle)]
        shoulder = (side * 0.2, neck[1], neck[2] - 0.05)
        parts.append((limb(shoulder, (side * bar[0], bar[1], bar[2]), 0.05, 0.032), above))
    parts.append((_torso((0, -0.18, seat - 0.04), neck, stage.at.uniform(0.85, 1.15)), above))
    head = _cloth(stage) if stage.chance(0.4) else skin
    return [*parts, (_head(neck[1] + 0.05, neck[2]), head)]


def bicycle(stage: Stage) -> Figure:
    """Return a bicycle: two open wheels, a frame of tubes, a bar and a saddle."""
    paint = plain(stage, [stage.at.uniform(0.01, 0.5) for _ in range(3)], 0.4)
    rubber = plain(stage, (0.015, 0.015, 0.015), 0.9)
    crank, seat, head = (0.0, -0.05, 0.29), (0.0, -0.2, 0.9), (0.0, 0.36, 0.86)
    back, front = (0.0, -0.52, WHEEL), (0.0, 0.54, WHEEL)
    tubes = [(crank, seat), (head, front), (crank, back), (seat, back), (head, crank), (head, seat)]
    parts: Parts = [(tyre(y, WHEEL, 0.022), rubber) for y in (back[1], front[1])]
    parts += [(limb(a, b, 0.017, 0.017, 5), paint) for a, b in tubes]
    parts.append((limb((-0.27, 0.32, 1.02), (0.27, 0.32, 1.02), 0.014, 0.014, 5), rubber))
    parts += [(limb(head, (0, 0.32, 1.02), 0.015, 0.015, 5), paint)]
    parts.append((box((0, -0.22, 0.95), (0.14, 0.26, 0.06)), rubber))
    if stage.chance(0.3):
        parts.append((box((0, 0.5, 0.92), (0.36, 0.26, 0.24)), rubber))  # a basket
    discs = [
        [(0.0, y + WHEEL * cos(k / 8 * pi), WHEEL + WHEEL * sin(k / 8 * pi)) for k in range(16)]
        for y in (back[1], front[1])
    ]
    return Figure(parts, [((points, [tuple(range(16))]), rubber) for points in discs])


def cyclist(stage: Stage) -> Figure:
    """Return a person on a bicycle."""
    parts, veil = bicycle(stage)
    return Figure([*parts, *rider(stage, 0.98, (0.25, 0.32, 1.02), 0.16)], veil)


def walker(stage: Stage) -> Figure:
    """Return a single pedestrian."""
    return Figure(person(stage), [])


def _with_pram(stage: Stage) -> Figure:
    """Return a person who pushes a pram or a trolley on thin legs and small wheels."""
    frame, cover = plain(stage, (0.05, 0.05, 0.05), 0.5), _cloth(stage)
    parts: Parts = [(box((0, 0.75, 0.72), (0.4, 0.62, 0.3)), cover)]
    for side in (-0.22, 0.22):
        parts += [(limb((side, 0.3, 1.0), (side, 0.95, 0.15), 0.012, 0.012, 5), frame)]
        parts += [(limb((side, 0.5, 0.15), (side, 0.85, 0.65), 0.012, 0.012, 5), frame)]
        for y in (0.5, 0.98):
            parts.append((moved(tyre(y, 0.12, 0.02, 12), (side, 0, 0)), frame))
    return Figure([*person(stage), *parts], [])


def _with_dog(stage: Stage) -> Figure:
    """Return a person with a dog on a lead."""
    coat = plain(stage, drawn(stage, palette("4 3 2, 30 22 12, 55 52 45")), 0.95, vary=0.4)
    x, size = stage.at.choice((-0.7, 0.7)), stage.at.uniform(0.5, 1.1)
    parts: Parts = []
    for side in (-0.08, 0.08):
        for y in (-0.25, 0.25):
            parts.append((limb((side, y, 0.42), (side, y, 0.0), 0.045, 0.025, 5), coat))
    parts.append((limb((0, -0.32, 0.48), (0, 0.3, 0.5), 0.12, 0.13), coat))
    parts.append((limb((0, 0.3, 0.52), (0, 0.55, 0.68), 0.09, 0.05), coat))
    parts.append((limb((0, -0.32, 0.5), (0, -0.55, 0.65), 0.03, 0.015, 4), coat))
    small = [(scaled(shape, (size, size, size)), look) for shape, look in parts]
    beside = [(moved(shape, (x, 0.5, 0)), look) for shape, look in small]
    return Figure([*person(stage), *beside], [])


def _on_scooter(stage: Stage) -> Figure:
    """Return a person on a scooter: a deck, a thin post, two small wheels."""
    dark = plain(stage, (0.04, 0.04, 0.045), 0.5)
    parts: Parts = [(box((0, 0, 0.12), (0.15, 0.75, 0.05)), dark)]
    parts += [(tyre(y, 0.1, 0.025, 12), dark) for y in (-0.42, 0.45)]
    parts.append((limb((0, 0.42, 0.1), (0, 0.3, 1.05), 0.02, 0.02, 5), dark))
    parts.append((limb((-0.24, 0.3, 1.05), (0.24, 0.3, 1.05), 0.015, 0.015, 5), dark))
    return Figure([*parts, *rider(stage, 1.0, (0.22, 0.3, 1.05), 0.2)], [])


FIGURES: dict[Callable[[Stage], Figure], float] = {
    walker: 10,
    cyclist: 4,
    _with_pram: 0.7,
    _with_dog: 0.8,
    _on_scooter: 0.8,
}
"""Kinds of people in a street, with their weights."""


class Cast:
    """The figures of a world, a few meshes that are placed any number of times."""

    def __init__(self, stage: Stage, count: int) -> None:
        makers = stage.at.choices(list(FIGURES), list(FIGURES.values()), k=count)
        self.stage = stage
        figures = [maker(stage) for maker in makers]
        self.meshes = [
            (stage.mesh(parts), stage.mesh(veil) if veil else None) for parts, veil in figures
        ]

    def put(self, where: Point, turn: float) -> None:
        """Place one of them at a position, facing an angle about z."""
        mesh, veil = self.stage.at.choice(self.meshes)
        put_figure(self.stage, mesh, veil, where, turn, self.stage.at.uniform(0.92, 1.06))


def put_figure(
    stage: Stage, mesh: Any, veil: Any, where: Point, turn: float, size: float = 1.0
) -> None:
    """Place a mesh, and its void parts, which only the truth shows."""
    stage.put(mesh, VERTICAL, where, turn, (size, size, size))
    if veil:
        stage.put(veil, VOID, where, turn, (size, size, size)).hide_render = True
