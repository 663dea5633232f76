"""The stage: what every part of a world is put on, and the shapes that parts are made of.

Metres; x to the right, y ahead, z up. A part has one truth, written as a colour that the pass of
``train.worlds.truth`` shows.
"""
# pyright: reportMissingImports=false
# (Blender is in an environment of its own)

from collections.abc import Iterable, Sequence
from math import cos, pi, sin
from random import Random
from typing import Any, NamedTuple

import bpy

SKY, VERTICAL, HORIZONTAL, ROAD, EGO, VOID = 0, 1, 2, 3, 4, 255
"""What a pixel of the truth says: layout without road, road, the carrying car, uncertain."""

COLOURS = {
    SKY: (0, 0, 0),
    VERTICAL: (0, 0, 1),
    HORIZONTAL: (0, 1, 0),
    ROAD: (1, 1, 0),
    EGO: (1, 0, 0),
    VOID: (1, 1, 1),
}
"""Of the truth, for its pass."""

Point = tuple[float, float, float]
Material = Any
Shape = tuple[Sequence[Point], Sequence[Sequence[int]]]
"""Points and the faces between them."""


class Haze(NamedTuple):
    """reach: metres at which 63 % of the light is the haze's; colour: linear, of the air."""

    reach: float
    colour: tuple[float, float, float]


class Stage:
    """One world: its scene, its random numbers, its air."""

    def __init__(self, at: Random) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene: Any = bpy.context.scene
        self.at = at
        self.haze = Haze(4000, (0.7, 0.75, 0.8))
        self.night = False

    def chance(self, share: float) -> bool:
        """Whether something happens that happens in a share of the worlds."""
        return self.at.random() < share

    def mesh(self, parts: Iterable[tuple[Shape, Material]], smooth: bool = False) -> Any:
        """One mesh of shapes, each with a material of its own; UV is not kept."""
        points: list[Point] = []
        faces: list[Sequence[int]] = []
        materials: list[Material] = []
        kinds: list[int] = []
        for (some, between), material in parts:
            if material not in materials:
                materials.append(material)
            kinds += [materials.index(material)] * len(between)
            faces += [[number + len(points) for number in face] for face in between]
            points += some
        mesh = bpy.data.meshes.new("part")
        mesh.from_pydata(points, [], faces)
        for material in materials:
            mesh.materials.append(material)
        mesh.polygons.foreach_set("material_index", kinds)
        mesh.polygons.foreach_set("use_smooth", [smooth] * len(faces))
        return mesh

    def put(
        self,
        mesh: Any,
        truth: int,
        where: Point = (0, 0, 0),
        turn: float = 0.0,
        size: Point = (1, 1, 1),
    ) -> Any:
        """Put a mesh (or one more copy of it) somewhere, turned about z by radians."""
        thing = bpy.data.objects.new("thing", mesh)
        thing.location, thing.rotation_euler, thing.scale = where, (0, 0, turn), size
        thing.color = (*COLOURS[truth], 1)
        self.scene.collection.objects.link(thing)
        return thing


# --- shapes -----------------------------------------------------------------------------


def box(middle: Point, size: Point) -> Shape:
    """A box of a size around its middle."""
    (x, y, z), (a, b, c) = middle, (side / 2 for side in size)
    points = [(x + i * a, y + j * b, z + k * c) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    return points, [
        (0, 1, 3, 2),
        (4, 6, 7, 5),
        (0, 4, 5, 1),
        (2, 3, 7, 6),
        (0, 2, 6, 4),
        (1, 5, 7, 3),
    ]


def turned(profile: Sequence[tuple[float, float]], sides: int = 10) -> Shape:
    """A profile of (radius, height) turned about z: posts, trunks, people."""
    points = [
        (r * cos(2 * pi * k / sides), r * sin(2 * pi * k / sides), z)
        for r, z in profile
        for k in range(sides)
    ]
    faces = [
        (
            i * sides + k,
            i * sides + (k + 1) % sides,
            (i + 1) * sides + (k + 1) % sides,
            (i + 1) * sides + k,
        )
        for i in range(len(profile) - 1)
        for k in range(sides)
    ]
    return points, faces


def moved(shape: Shape, by: Point) -> Shape:
    """The same shape elsewhere."""
    return [(x + by[0], y + by[1], z + by[2]) for x, y, z in shape[0]], shape[1]


def wheel(x: float, y: float, radius: float, wide: float) -> Shape:
    """A wheel that stands on z = 0, its axle along x."""
    points, faces = turned(
        [(0.01, -wide / 2), (radius, -wide / 2), (radius, wide / 2), (0.01, wide / 2)], 14
    )
    return [(x + c, y + a, radius + b) for a, b, c in points], faces


def extruded(outline: Sequence[tuple[float, float]], halves: Sequence[float]) -> Shape:
    """An outline of (y, z) to both sides of x = 0, as far as ``halves`` says of each point."""
    n = len(outline)
    points = [
        (side * half, y, z)
        for side in (-1, 1)
        for (y, z), half in zip(outline, halves, strict=True)
    ]
    faces: list[Sequence[int]] = [list(range(n)), [2 * n - 1 - k for k in range(n)]]
    return points, faces + [(k, n + k, n + (k + 1) % n, (k + 1) % n) for k in range(n)]
