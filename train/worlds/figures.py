"""People, vehicles and small things, made as things.csv says; limbs and posts have true thickness.

A row is a part of a thing: the probability that it has it, its material, its shape, and for each
such shape its centimetres, separated by ";". A shape with ± has a twin on the other side. The shape
may be another thing, by its offset. Parts of the material "veil" are see-through, as between
spokes; nobody labels them as road.
"""

from math import cos, pi, sin
from typing import Any

from train.worlds.materials import COLOURS, lamp, plain
from train.worlds.scene import Material, Parts, Scene, Shape
from train.worlds.shapes import box, extrude, limb, revolve, stretch, translate, tyre, wheel
from train.worlds.tables import Row, read_table

ROUGH = {"paint": 0.25, "livery": 0.3, "cloth": 0.9, "trousers": 0.9, "rubber": 0.9, "glass": 0.06}
"""Roughness of materials; of all others 0.6."""

SIZES = {"bollard": (0.5, 1.5), "post": (0.7, 1.3), "sign": (0.6, 1.4), "lorry": (0.75, 1.3)}
SIZES |= dict.fromkeys(("walker", "stander"), (0.85, 1.1)) | {"child": (0.55, 0.8)}
"""Factors, from … to, by which things are stretched along each axis; all others by a little."""

PARTS: dict[str, list[Row]] = {}
for row in read_table("things"):
    PARTS.setdefault(row["thing"], []).append(row)
PARTS["child"] = PARTS["walker"]


def build_thing(scene: Scene, name: str) -> tuple[Parts, Parts]:
    """Return the parts of a thing at the origin that faces y, and its veil."""
    materials: dict[str, Material] = {}
    parts, veil = [], []
    x, y, z = (scene.between(SIZES.get(name, (0.95, 1.06))) for _ in range(3))
    for row in PARTS[name]:
        shape, kind = row["shape"].rstrip("±"), row["material"]
        if not scene.chance(row["chance"]):
            continue
        numbers = [[float(n) / 100 for n in part.split()] for part in row["centimetres"].split(";")]
        if shape in PARTS:
            pieces, more = build_thing(scene, shape)
            parts += [(translate(piece, tuple(numbers[0])), material) for piece, material in pieces]
            veil += more
            continue
        if kind not in materials:
            materials[kind] = sample_material(scene, kind)
        shapes = [stretch(piece, (x, y, z)) for piece in SHAPES[shape](numbers)]
        if "±" in row["shape"]:
            shapes += [stretch(piece, (-1, 1, 1)) for piece in shapes]
        (veil if kind == "veil" else parts).extend((piece, materials[kind]) for piece in shapes)
    return parts, veil


def _disc(y: float, radius: float) -> Shape:
    turns = [pi * k / 8 for k in range(16)]
    rim = [(0.0, y + radius * cos(turn), radius + radius * sin(turn)) for turn in turns]
    return rim, [tuple(range(16))]


def _ball(row: Any) -> Shape:
    profile = [(sin(k / 8 * pi) + 1e-3, -cos(k / 8 * pi)) for k in range(9)]
    return translate(stretch(revolve(profile, 16), row[3:]), row[:3])


SHAPES: dict[str, Any] = {
    "box": lambda rows: [box(row[:3], row[3:]) for row in rows],
    "ball": lambda rows: [_ball(row) for row in rows],
    "limb": lambda rows: [limb(row[:3], row[3:6], *row[6:]) for row in rows],
    "wheel": lambda rows: [wheel(*row) for row in rows],
    "tyre": lambda rows: [translate(tyre(*row[1:4]), (row[0], 0, sum(row[4:]))) for row in rows],
    "disc": lambda rows: [_disc(*row) for row in rows],
    "extrude": lambda rows: [extrude([row[:2] for row in rows], [row[2] for row in rows])],
    "turned": lambda rows: [translate(revolve(rows[1:]), (*rows[0], 0))],
}
"""Shapes of the table, by their rows of metres."""

LIGHTS = {"tail": ((1, 0.03, 0.01), (0.4, 0.01, 0.01), 6), "head": ((1, 0.95, 0.8), (0.6,) * 3, 40)}
"""Colours of lights that are lit and not, and their strength at night."""


def sample_material(scene: Scene, name: str) -> Material:
    """Sample a material by its name in the table; lights shine at night."""
    if name in LIGHTS:
        lit, unlit, strength = LIGHTS[name]
        if scene.night or scene.chance(0.2):
            return lamp(lit, strength if scene.night else 3)
        return plain(scene, unlit, 0.3)
    if name in ("cloth", "trousers", "cover", "bag"):
        bright = scene.rng.choice((0.05, 0.2, 0.6))
        return plain(scene, [scene.rng.uniform(0.01, bright) for _ in range(3)], 0.9)
    if name == "mirror":
        return plain(scene, (0.8, 0.8, 0.8), 0.03, metal=1.0, vary=0)
    if name == "shade":
        name = scene.rng.choice(("paint", "dark"))
    if name in ("glass", "rubber", "veil"):
        return plain(scene, (0.015, 0.016, 0.018), ROUGH.get(name, 1.0), vary=0)
    colour = name if name in COLOURS else "grey"
    return plain(scene, colour, ROUGH.get(name, 0.6), 0.6 * (name == "metal"), 0.08)
