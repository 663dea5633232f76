"""Shapes that parts of a world are made of: points, and the faces between them."""

from collections.abc import Sequence
from math import cos, pi, sin

from train.worlds.blender import Vector
from train.worlds.scene import Point, Shape


def box(middle: Point, size: Point) -> Shape:
    """Return a box of a size around its middle."""
    (x, y, z), (a, b, c) = middle, (side / 2 for side in size)
    points = [(x + i * a, y + j * b, z + k * c) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1)]
    return points, [*sides, (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def triangles(points: Sequence[Point]) -> Shape:
    """Return separate triangles, of three points each: leaves, twigs, blades."""
    return points, [(first, first + 1, first + 2) for first in range(0, len(points), 3)]


def revolve(profile: Sequence[tuple[float, float]], sides: int = 10) -> Shape:
    """Revolve a profile of (radius, height) about z: posts, trunks, people."""
    turns = [2 * pi * k / sides for k in range(sides)]
    points = [(r * cos(turn), r * sin(turn), z) for r, z in profile for turn in turns]
    faces = [
        (low + k, low + (k + 1) % sides, low + sides + (k + 1) % sides, low + sides + k)
        for low in range(0, (len(profile) - 1) * sides, sides)
        for k in range(sides)
    ]
    return points, faces


def translate(shape: Shape, by: Sequence[float]) -> Shape:
    """Translate a shape."""
    return [(x + by[0], y + by[1], z + by[2]) for x, y, z in shape[0]], shape[1]


def stretch(shape: Shape, by: Sequence[float]) -> Shape:
    """Stretch a shape along the axes."""
    return [(x * by[0], y * by[1], z * by[2]) for x, y, z in shape[0]], shape[1]


def wheel(x: float, y: float, radius: float, wide: float) -> Shape:
    """Return a wheel that touches z = 0, its axle along x."""
    half = wide / 2
    points, faces = revolve([(0.01, -half), (radius, -half), (radius, half), (0.01, half)], 14)
    return [(x + c, y + a, radius + b) for a, b, c in points], faces


def extrude(outline: Sequence[tuple[float, float]], halves: Sequence[float]) -> Shape:
    """Extrude an outline of (y, z) to both sides of x = 0, by ``halves`` of each point."""
    n, rim = len(outline), list(zip(outline, halves, strict=True))
    points = [(side * half, y, z) for side in (-1, 1) for (y, z), half in rim]
    faces: list[Sequence[int]] = [list(range(n)), [2 * n - 1 - k for k in range(n)]]
    return points, faces + [(k, n + k, n + (k + 1) % n, (k + 1) % n) for k in range(n)]


def limb(start: Point, end: Point, radius: float, last: float) -> Shape:
    """Return a tube between two points that tapers from one radius to another."""
    sides = 6 if radius < 0.03 else 8 if radius < 0.1 else 18
    axis = Vector(end) - Vector(start)
    across = axis.orthogonal().normalized()
    upward = axis.cross(across).normalized()
    points: list[Point] = []
    for middle, wide in ((start, radius), (end, last)):
        for k in range(sides):
            turn = 2 * pi * k / sides
            rim = Vector(middle) + wide * (cos(turn) * across + sin(turn) * upward)
            points.append((rim.x, rim.y, rim.z))
    faces: list[list[int]] = [
        [k, (k + 1) % sides, sides + (k + 1) % sides, sides + k] for k in range(sides)
    ]
    return points, [*faces, list(range(sides)), list(range(sides, 2 * sides))]


def tyre(y: float, radius: float, thick: float, sides: int = 20) -> Shape:
    """Return an open ring in the plane x = 0 that touches z = 0."""
    points: list[Point] = []
    for k in range(sides):
        turn = 2 * pi * k / sides
        for across, out in ((-thick, 0.0), (0.0, thick), (thick, 0.0), (0.0, -thick)):
            reach = radius - thick + out
            points.append((across, y + reach * cos(turn), radius + reach * sin(turn)))
    pairs = [(4 * k, 4 * ((k + 1) % sides)) for k in range(sides)]
    edges = ((0, 1), (1, 2), (2, 3), (3, 0))
    return points, [(k + a, k + b, n + b, n + a) for k, n in pairs for a, b in edges]
