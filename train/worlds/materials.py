"""Materials: colour variation, grain, cracks, stones, water, snow, windows."""

from collections.abc import Sequence
from typing import Any

import bpy

from train.worlds.photographs import lay_photograph
from train.worlds.stage import Material, Stage

Colour = Sequence[float]
"""Linear RGB, 0 to 1."""

BLACK = (0.0, 0.0, 0.0)


def palette(text: str) -> list[tuple[float, ...]]:
    """Parse colours given in percent: ``"32 24 16, 40 36 30"``."""
    return [tuple(float(part) / 100 for part in one.split()) for one in text.split(",")]


def drawn(stage: Stage, colours: Sequence[Colour], spread: float = 0.25) -> tuple[float, ...]:
    """Sample one of some colours, with random brightness and tint."""
    at, light = stage.at, stage.at.uniform(1 - spread, 1 + spread)
    return tuple(min(0.95, max(0.0, c * light * at.gauss(1, 0.06))) for c in at.choice(colours))


class Nodes:
    """Node graph of a material or world: each call adds a node and returns its first output."""

    def __init__(self, owner: Any) -> None:
        owner.use_nodes = True
        self.owner, self.tree = owner, owner.node_tree
        self.tree.nodes.clear()

    def add(self, kind: str, inputs: dict[Any, Any], output: Any = 0, **properties: Any) -> Any:
        """Add a node; inputs by name or number, values or other nodes' sockets."""
        made = self.tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(made, name, value)
        for name, value in inputs.items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, made.inputs[name])
            else:
                made.inputs[name].default_value = value
        return made.outputs[output] if made.outputs else None

    def math(self, what: str, a: Any, b: Any = 0.0) -> Any:
        """Combine two numbers by an operation."""
        return self.add("ShaderNodeMath", {0: a, 1: b}, operation=what)

    def mix(self, share: Any, a: Any, b: Any) -> Any:
        """Mix colours: b by a fraction, a for the rest."""
        a, b = ((*one, 1.0) if isinstance(one, tuple | list) else one for one in (a, b))
        return self.add("ShaderNodeMix", {0: share, 6: a, 7: b}, 2, data_type="RGBA")

    def step(self, value: Any, low: float, high: float) -> Any:
        """Return 0 below low and 1 above high (or reversed), smooth between."""
        given = {0: value, 1: low, 2: high, 3: 0.0, 4: 1.0}
        return self.add("ShaderNodeMapRange", given, interpolation_type="SMOOTHSTEP")

    def place(self) -> Any:
        """Return the position in the world, in metres."""
        return self.add("ShaderNodeNewGeometry", {}, "Position")

    def noise(self, scale: float, detail: float = 3.0, where: Any = None) -> Any:
        """Return smooth noise about .5 with ``scale`` bumps a metre."""
        given = {"Vector": where or self.place(), "Scale": scale, "Detail": detail}
        return self.add("ShaderNodeTexNoise", given | {"Roughness": 0.65}, "Fac")

    def cells(self, size: float, where: Any = None) -> Any:
        """Return the distance to the edge of irregular cells, in metres over size."""
        given = {"Vector": where or self.place(), "Scale": 1 / size}
        return self.add("ShaderNodeTexVoronoi", given, "Distance", feature="DISTANCE_TO_EDGE")

    def bump(self, height: Any, strength: float, distance: float) -> Any:
        """Return the normals of an uneven surface."""
        given = {"Strength": strength, "Distance": distance, "Height": height}
        return self.add("ShaderNodeBump", given)


def new_surface() -> Nodes:
    """Return the graph of a new material."""
    return Nodes(bpy.data.materials.new("surface"))


def finished(
    stage: Stage, nodes: Nodes, look: Any, rough: Any, more: dict[str, Any] | None = None
) -> Material:
    """Finish a material: add haze, whose colour hides it with distance.

    more: further inputs of the shader, such as ``Normal``.
    """
    given = {"Base Color": look, "Roughness": rough, **(more or {})}
    shader = nodes.add("ShaderNodeBsdfPrincipled", given)
    ray = nodes.tree.nodes.new("ShaderNodeLightPath").outputs
    gone = nodes.math("DIVIDE", ray["Ray Length"], -stage.haze.reach)
    gone = nodes.math("SUBTRACT", 1.0, nodes.math("EXPONENT", gone))
    gone = nodes.math("MULTIPLY", gone, ray["Is Camera Ray"])
    air = nodes.add("ShaderNodeEmission", {"Color": (*stage.haze.colour, 1)})
    seen = nodes.add("ShaderNodeMixShader", {0: gone, 1: shader, 2: air})
    nodes.add("ShaderNodeOutputMaterial", {"Surface": seen})
    return nodes.owner


def plain(
    stage: Stage, colour: Colour, rough: float = 0.8, metal: float = 0.0, vary: float = 0.15
) -> Material:
    """Return a material of one slightly varied colour: paint, plastic, metal."""
    nodes, dark = new_surface(), tuple(c * (1 - vary) for c in colour)
    look = nodes.mix(nodes.noise(stage.at.uniform(0.3, 3)), dark, tuple(colour))
    return finished(stage, nodes, look, rough, {"Metallic": metal})


def lamp(colour: Colour, strength: float) -> Material:
    """Return an emitting material: bulbs, tail lights, lit windows."""
    nodes = new_surface()
    given = {"Color": (*colour, 1), "Strength": strength}
    nodes.add("ShaderNodeOutputMaterial", {"Surface": nodes.add("ShaderNodeEmission", given)})
    return nodes.owner


def ground(
    stage: Stage,
    colour: Colour,
    other: Colour,
    grain: float,
    contrast: float = 0.25,
    bump: float = 0.3,
    photo: tuple[str, str] = ("", ""),
) -> Material:
    """Return grass, earth, leaves or snow: patches of two colours with soft transitions.

    photo: kinds of photographs of both.
    """
    nodes = new_surface()
    look, fine = _patches(stage, nodes, (colour, other), grain, contrast, photo)
    return finished(stage, nodes, look, 0.95, {"Normal": nodes.bump(fine, bump, 0.05)})


def trodden(
    stage: Stage,
    colours: tuple[Colour, Colour],
    grain: float,
    contrast: float,
    bare: Colour,
    wear: tuple[float, float],
    photo: tuple[str, str] = ("", ""),
) -> Material:
    """Return the surrounding ground (two colours, grain, contrast) worn bare by wheels.

    wear: fractions of ``bare`` over the whole width, and in the two wheel tracks.
    """
    at, nodes = stage.at, new_surface()
    look, fine = _patches(stage, nodes, colours, grain, contrast, photo)
    share = nodes.math("MULTIPLY", _wheel_tracks(stage, nodes, _across(nodes)), wear[1])
    share = nodes.math("ADD", share, wear[0])
    share = nodes.math("MULTIPLY", share, nodes.step(nodes.noise(at.uniform(0.4, 2)), 0.2, 0.7))
    look = nodes.mix(share, look, lay_photograph(stage, nodes, photo[0] and "earth", tuple(bare)))
    return finished(stage, nodes, look, 0.95, {"Normal": nodes.bump(fine, 0.3, 0.05)})


def _patches(
    stage: Stage,
    nodes: Nodes,
    colours: tuple[Colour, Colour],
    grain: float,
    contrast: float,
    photo: tuple[str, str],
) -> tuple[Any, Any]:
    """Return a colour in patches of two with grain, and the height of the grain."""
    fine = nodes.noise(grain, 4)
    wide = nodes.step(nodes.noise(stage.at.uniform(0.05, 0.6)), 0.1, 0.9)
    looks = [
        lay_photograph(stage, nodes, kind, tuple(colour), tuple(colour))
        for kind, colour in zip(photo, colours, strict=True)
    ]
    look = nodes.mix(wide, *looks)
    return nodes.mix(nodes.step(fine, 0.3, 0.7), nodes.mix(contrast, look, BLACK), look), fine


def _across(nodes: Nodes) -> Any:
    """Return the offset from the middle of the road in metres, the first UV coordinate."""
    across = nodes.add("ShaderNodeTexCoord", {}, "UV")
    return nodes.math("ABSOLUTE", nodes.add("ShaderNodeSeparateXYZ", {0: across}, 0))


def _wheel_tracks(stage: Stage, nodes: Nodes, across: Any) -> Any:
    """Return the wear by wheels, 0 to 1."""
    gauge = stage.at.uniform(1.5, 1.9)
    wave = nodes.math("COSINE", nodes.math("MULTIPLY", across, 6.28 / gauge))
    return nodes.step(wave, 0.4, -0.8)


def paved(
    stage: Stage,
    colour: Colour,
    half: float,
    wet: float = 0.0,
    stones: float = 0.0,
    slush: Colour | None = None,
    ruts: float = 0.0,
    edge: Colour | None = None,
    photo: str = "",
) -> Material:
    """Return a road surface: grain, patches, cracks, wheel tracks, edges; wet, stones, slush.

    half: its half width in metres, the scale of the first UV coordinate. wet: fraction under water.
    stones: their size in metres. ruts: brightness of wheel tracks. photo: kind of photographs, by
    default cobbles where there are stones, else asphalt.
    """
    at, nodes = stage.at, new_surface()
    across = _across(nodes)
    fine, wide = nodes.noise(at.uniform(15, 60)), nodes.noise(at.uniform(0.1, 0.5))
    dark = tuple(c * at.uniform(0.75, 1) for c in colour)
    look: Any = nodes.mix(nodes.step(wide, 0.3, 0.7), dark, tuple(colour))
    flat, grain = look, nodes.mix(at.uniform(0.1, 0.45), look, BLACK)
    look = nodes.mix(nodes.step(fine, 0.3, 0.75), grain, look)
    if stones:
        joints = nodes.step(nodes.cells(stones), 0.12, 0.02)
        look = nodes.mix(joints, look, nodes.mix(at.uniform(0.3, 0.75), look, BLACK))
    look = lay_photograph(stage, nodes, photo or ("cobbles" if stones else "asphalt"), flat, look)
    if not stones and stage.chance(0.3):
        look = _cracked(nodes, look, at.uniform(0.15, 0.6), at.uniform(0.004, 0.012))
    track = _wheel_tracks(stage, nodes, across)
    if ruts:
        tone = BLACK if ruts > 0 else (0.9, 0.85, 0.75)
        look = nodes.mix(nodes.math("MULTIPLY", track, abs(ruts)), look, tone)
    if slush:
        share = nodes.math("ADD", nodes.noise(at.uniform(0.3, 1.2)), at.uniform(-0.25, 0.25))
        share = nodes.math("SUBTRACT", share, nodes.math("MULTIPLY", track, at.uniform(0, 0.4)))
        look = nodes.mix(nodes.step(share, 0.35, 0.55), look, tuple(slush))
    if edge:
        frayed = nodes.math("MULTIPLY", nodes.noise(at.uniform(0.5, 2)), 0.9)
        near = nodes.step(nodes.math("ADD", across, frayed), half + 0.15, half + 0.6)
        look = nodes.mix(near, look, tuple(edge))
    rough: Any = at.uniform(0.6, 1)
    if wet:
        look, rough = under_water(nodes, look, at.uniform(0.1, 0.7), wet, at.uniform(0.45, 0.66))
    normal = nodes.bump(fine, at.uniform(0.05, 0.4), 0.02)
    return finished(stage, nodes, look, rough, {"Normal": normal})


def slabs(
    stage: Stage, colour: Colour, size: float, wet: float = 0.0, slush: Colour | None = None
) -> Material:
    """Return a pavement of slabs with a longer side in metres; wet or under snow."""
    at, nodes = stage.at, new_surface()
    x, y = (nodes.add("ShaderNodeSeparateXYZ", {0: nodes.place()}, k) for k in (0, 1))
    flat = nodes.add("ShaderNodeCombineXYZ", {0: x, 1: y})
    light, dark, joint = (tuple(c * by for c in colour) for by in (1.0, at.uniform(0.7, 1), 0.45))
    given = {
        "Vector": flat,
        "Scale": 1.0,
        "Brick Width": size,
        "Mortar Size": at.uniform(0.006, 0.02),
    }
    given |= {"Row Height": size * at.choice([0.5, 1.0]), "Bias": at.uniform(-0.6, 0.6)}
    given |= {"Color1": (*light, 1), "Color2": (*dark, 1), "Mortar": (*joint, 1)}
    look = nodes.add("ShaderNodeTexBrick", given, "Color", offset=at.choice([0.0, 0.5]))
    look = lay_photograph(stage, nodes, "slabs", tuple(colour), look)
    stain = nodes.step(nodes.noise(at.uniform(0.3, 2)), 0.35, 0.65)
    look = nodes.mix(nodes.math("MULTIPLY", stain, at.uniform(0, 0.4)), look, BLACK)
    if slush:
        share = nodes.math("ADD", nodes.noise(at.uniform(0.3, 1.2)), at.uniform(-0.15, 0.3))
        look = nodes.mix(nodes.step(share, 0.35, 0.55), look, tuple(slush))
    rough: Any = at.uniform(0.6, 1)
    if wet:
        look, rough = under_water(nodes, look, at.uniform(0.1, 0.7), wet, at.uniform(0.45, 0.66))
    return finished(stage, nodes, look, rough)


def under_water(nodes: Nodes, look: Any, grain: float, wet: float, shine: float) -> tuple[Any, Any]:
    """Darken and smooth a fraction of a surface where water stands; return colour and roughness."""
    water = nodes.step(nodes.noise(grain), 0.75 - wet * 0.6, 0.6 - wet * 0.6)
    water = nodes.math("SUBTRACT", 1.0, water)
    look = nodes.mix(nodes.math("MULTIPLY", water, 0.5), look, BLACK)
    return look, nodes.math("SUBTRACT", 0.7, nodes.math("MULTIPLY", water, shine))


def _cracked(nodes: Nodes, look: Any, often: float, wide: float) -> Any:
    """Return dark lines between cells distorted by noise, metres apart."""
    bend = nodes.add("ShaderNodeTexNoise", {"Vector": nodes.place(), "Scale": 0.8}, "Color")
    where = nodes.add("ShaderNodeVectorMath", {0: nodes.place(), 1: bend}, operation="ADD")
    line = nodes.step(nodes.cells(1 / often * 2, where), wide, wide / 3)
    part = nodes.step(nodes.noise(0.25, 1), 0.45, 0.6)  # not everywhere
    return nodes.mix(nodes.math("MULTIPLY", line, part), look, nodes.mix(0.6, look, BLACK))


def facade(stage: Stage, colour: Colour) -> Material:
    """Return a wall with rows of windows every 2 to 4 metres, some lit at night."""
    at, nodes = stage.at, new_surface()
    where = nodes.add("ShaderNodeTexCoord", {}, "Object")
    x, y, z = (nodes.add("ShaderNodeSeparateXYZ", {0: where}, k) for k in range(3))
    along = nodes.math("DIVIDE", nodes.math("ADD", x, y), at.uniform(2, 4))
    up = nodes.math("DIVIDE", z, at.uniform(2.6, 3.4))
    inside = []
    for one, half in ((along, at.uniform(0.15, 0.4)), (up, at.uniform(0.2, 0.35))):
        off = nodes.math("SUBTRACT", nodes.math("FRACT", one), 0.5)
        inside.append(nodes.step(nodes.math("ABSOLUTE", off), half, half - 0.03))
    pane = nodes.math("MULTIPLY", *inside)
    wall = nodes.mix(nodes.noise(at.uniform(0.3, 8)), tuple(c * 0.7 for c in colour), tuple(colour))
    wall = lay_photograph(stage, nodes, "wall", wall)
    look = nodes.mix(pane, wall, (0.03, 0.035, 0.05))
    rough = nodes.math("SUBTRACT", 0.9, nodes.math("MULTIPLY", pane, 0.8))
    if not stage.night:
        return finished(stage, nodes, look, rough)
    lit = nodes.math("MULTIPLY", nodes.step(nodes.noise(0.35, 1), 0.52, 0.56), 0.4)
    shine = {
        "Emission Color": (1, 0.7, 0.35, 1),
        "Emission Strength": nodes.math("MULTIPLY", pane, lit),
    }
    return finished(stage, nodes, look, rough, shine)
