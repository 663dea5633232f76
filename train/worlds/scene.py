"""The scene to which the parts of a world are added.

Metres; x to the right, y ahead, z up. A part has one truth, written as a colour that the pass of
``render_truth`` shows.
"""

from collections.abc import Iterable, Mapping, Sequence
from random import Random
from typing import Any, NamedTuple

from train.worlds.blender import bpy
from train.worlds.truth import COLOURS

WIDTH, HEIGHT = 384, 288
"""Width and height of the images: no network sees larger ones, and all of them this shape."""

Point = tuple[float, float, float]
Material = Any
Shape = tuple[Sequence[Point], Sequence[Sequence[int]]]
"""Points, and the faces between them."""
Parts = list[tuple[Shape, Material]]


class Haze(NamedTuple):
    """reach: metres after which 63 % of the light is the haze's; colour: linear RGB of the air."""

    reach: float
    colour: tuple[float, float, float]


class Scene:
    """A world: its Blender scene, its random generator, its light and weather, its camera."""

    def __init__(self, rng: Random, hand: int) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.blender: Any = bpy.context.scene
        self.rng = rng
        self.hand = hand  # 1 where traffic keeps right, -1 left
        self.haze = Haze(4000, (0.7, 0.75, 0.8))
        self.light = "sun"
        self.falling = 0.0  # rain or snow in the air, 0 to 1
        self.water = 0.0  # on paved ground: 0 dry, 1 wet all over, more is mirror-like
        self.station = 0  # the point of the road's course at which the camera is
        self.looks_back = False  # whether the camera sees sideways and behind
        self.lens: Any = None  # train.worlds.lens.Fisheye, if the camera has one
        self.mount: dict[str, float] = {}  # how that is mounted: height, and degrees

    @property
    def night(self) -> bool:
        """Whether lamps are lit."""
        return self.light == "night"

    def chance(self, probability: float) -> bool:
        """Sample whether an event of a probability happens."""
        return self.rng.random() < probability

    def pick(self, weights: Mapping[str, float]) -> str:
        """Sample a key by its weight."""
        return self.rng.choices(list(weights), list(weights.values()))[0]

    def between(self, limits: tuple[float, float]) -> float:
        """Sample a number uniformly between two limits."""
        return self.rng.uniform(*limits)

    def mesh(self, parts: Iterable[tuple[Shape, Material]], smooth: bool = False) -> Any:
        """Make a mesh of shapes, each with a material."""
        points: list[Point] = []
        faces: list[Sequence[int]] = []
        materials: list[Material] = []
        indices: list[int] = []
        for (corners, polygons), material in parts:
            if material not in materials:
                materials.append(material)
            indices += [materials.index(material)] * len(polygons)
            faces += [[number + len(points) for number in polygon] for polygon in polygons]
            points += corners
        mesh = bpy.data.meshes.new("part")
        mesh.from_pydata(points, [], faces)
        for material in materials:
            mesh.materials.append(material)
        mesh.polygons.foreach_set("material_index", indices)
        mesh.polygons.foreach_set("use_smooth", [smooth] * len(faces))
        return mesh

    def put(
        self,
        mesh: Any,
        truth: int,
        position: Point = (0, 0, 0),
        turn: float = 0.0,
        size: Point = (1, 1, 1),
    ) -> Any:
        """Place a mesh (or a further copy of it), rotated about z by radians."""
        thing = self.add("thing", mesh, position)
        thing.rotation_euler, thing.scale = (0, 0, turn), size
        thing.color = (*COLOURS[truth], 1)
        return thing

    def put_surface(
        self,
        points: Sequence[Point],
        faces: Sequence[Sequence[int]],
        material: Material,
        truth: int,
        uvs: Sequence[tuple[float, float]] = (),
    ) -> None:
        """Place a surface of faces between points, with coordinates of its material or zeros."""
        mesh = self.mesh([((points, faces), material)])
        layer = mesh.uv_layers.new(name="UV")
        if uvs:
            flat = [value for face in faces for k in face for value in uvs[k]]
            layer.data.foreach_set("uv", flat)
        self.put(mesh, truth)

    def put_plane(self, size: float, up: float, material: Material, truth: int) -> None:
        """Place a square about the origin, by half its side and its height."""
        corners = [(x * size, y * size, up) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        self.put_surface(corners, [(0, 1, 2, 3)], material, truth)

    def add(self, name: str, data: Any, position: Point) -> Any:
        """Place a mesh, a light or a camera."""
        thing = bpy.data.objects.new(name, data)
        thing.location = position
        self.blender.collection.objects.link(thing)
        return thing

    def add_lamp(self, position: Point, colour: Sequence[float], watts: float) -> None:
        """Add a small lamp that shines in all directions."""
        data: Any = bpy.data.lights.new("lamp", "POINT")
        data.energy, data.color, data.shadow_soft_size = watts, colour, 0.1
        self.add("lamp", data, position)
