"""The scene to which the parts of a world are added, and the shapes that parts are made of.

Metres; x to the right, y ahead, z up. A part has one truth, written as a colour that the pass of
``render_truth`` shows.
"""

from collections.abc import Iterable, Sequence
from math import cos, pi, sin
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import bpy

from train.worlds.truth import COLOURS

WIDTH, HEIGHT = 512, 384
"""Width and height of the images, to which other aspect ratios are squeezed, as by the networks."""

Point = tuple[float, float, float]
Material = Any
Shape = tuple[Sequence[Point], Sequence[Sequence[int]]]
"""Points, and the faces between them."""
Parts = list[tuple[Shape, Material]]


class Haze(NamedTuple):
    """reach: metres after which 63 % of the light is the haze's; colour: linear RGB of the air."""

    reach: float
    colour: tuple[float, float, float]


class Stage:
    """A world: its scene, its random generator, its haze."""

    def __init__(self, at: Random, photographs: Path | None = None) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene: Any = bpy.context.scene
        self.at = at
        self.haze = Haze(4000, (0.7, 0.75, 0.8))
        self.hour = "sun"
        self.falling = 0.0  # rain or snow in the air, 0 to 1
        self.wet: bool | None = None  # whether the road is wet; None leaves it to chance
        self.hand = 0  # 1 where traffic keeps right, -1 left, 0 not known
        self.station = 0  # the point of the road's course at which the camera stands
        self.around = False  # whether the camera sees sideways and behind
        self.lens: Any = None  # train.worlds.lens.Fisheye, where it is one
        self.photographs = photographs  # a folder of them for materials
        self.pick = Random(str(at.getstate()[1][:8]))  # of photographs alone
        self.mount: dict[str, float] = {}  # how that is mounted: height, and degrees

    @property
    def night(self) -> bool:
        """Whether lamps are lit."""
        return self.hour == "night"

    def chance(self, share: float) -> bool:
        """Sample whether an event of a probability happens."""
        return self.at.random() < share

    def mesh(self, parts: Iterable[tuple[Shape, Material]], smooth: bool = False) -> Any:
        """Make a mesh of shapes, each with a material of its own."""
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
        """Place a mesh (or a further copy of it), rotated about z by radians."""
        thing = self.add("thing", mesh, where)
        thing.rotation_euler, thing.scale = (0, 0, turn), size
        thing.color = (*COLOURS[truth], 1)
        return thing

    def add(self, name: str, data: Any, where: Point) -> Any:
        """Place a mesh, a light or a camera."""
        thing = bpy.data.objects.new(name, data)
        thing.location = where
        self.scene.collection.objects.link(thing)
        return thing


# --- shapes -----------------------------------------------------------------------------


def box(middle: Point, size: Point) -> Shape:
    """Return a box of a size around its middle."""
    (x, y, z), (a, b, c) = middle, (side / 2 for side in size)
    points = [(x + i * a, y + j * b, z + k * c) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1)]
    return points, [*sides, (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def loose(points: Sequence[Point]) -> Shape:
    """Return separate triangles, of three points each: leaves, twigs, blades."""
    return points, [(first, first + 1, first + 2) for first in range(0, len(points), 3)]


def turned(profile: Sequence[tuple[float, float]], sides: int = 10) -> Shape:
    """Revolve a profile of (radius, height) about z: posts, trunks, people."""
    turns = [2 * pi * k / sides for k in range(sides)]
    points = [(r * cos(turn), r * sin(turn), z) for r, z in profile for turn in turns]
    faces = [
        (low + k, low + (k + 1) % sides, low + sides + (k + 1) % sides, low + sides + k)
        for low in range(0, (len(profile) - 1) * sides, sides)
        for k in range(sides)
    ]
    return points, faces


def moved(shape: Shape, by: Point) -> Shape:
    """Translate a shape."""
    return [(x + by[0], y + by[1], z + by[2]) for x, y, z in shape[0]], shape[1]


def wheel(x: float, y: float, radius: float, wide: float) -> Shape:
    """Return a wheel that stands on z = 0, its axle along x."""
    half = wide / 2
    points, faces = turned([(0.01, -half), (radius, -half), (radius, half), (0.01, half)], 14)
    return [(x + c, y + a, radius + b) for a, b, c in points], faces


def extruded(outline: Sequence[tuple[float, float]], halves: Sequence[float]) -> Shape:
    """Extrude an outline of (y, z) to both sides of x = 0, by ``halves`` of each point."""
    n, rim = len(outline), list(zip(outline, halves, strict=True))
    points = [(side * half, y, z) for side in (-1, 1) for (y, z), half in rim]
    faces: list[Sequence[int]] = [list(range(n)), [2 * n - 1 - k for k in range(n)]]
    return points, faces + [(k, n + k, n + (k + 1) % n, (k + 1) % n) for k in range(n)]
