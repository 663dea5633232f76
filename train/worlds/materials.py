"""How surfaces look: colour that varies, grain, cracks, stones, water, snow, windows."""
# pyright: reportMissingImports=false
# (Blender is in an environment of its own)

from collections.abc import Sequence
from typing import Any

import bpy

from train.worlds.stage import Material, Stage

Colour = Sequence[float]


class Nodes:
    """A material's graph: a node a call, sockets as arguments, the first output as result."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree

    def add(self, kind: str, inputs: dict[Any, Any], output: Any = 0, **properties: Any) -> Any:
        """One node; inputs by name or number, values or other nodes' sockets."""
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
        """A number from two."""
        return self.add("ShaderNodeMath", {0: a, 1: b}, operation=what)

    def mix(self, share: Any, a: Any, b: Any) -> Any:
        """Colour b for a share, a for the rest."""
        given = {0: share, 6: _rgba(a), 7: _rgba(b)}
        return self.add("ShaderNodeMix", given, 2, data_type="RGBA")

    def step(self, value: Any, low: float, high: float) -> Any:
        """0 below low, 1 above high (or the other way round), smooth between."""
        given = {0: value, 1: low, 2: high, 3: 0.0, 4: 1.0}
        return self.add("ShaderNodeMapRange", given, interpolation_type="SMOOTHSTEP")

    def place(self) -> Any:
        """Where a point is in the world, metres."""
        return self.add("ShaderNodeNewGeometry", {}, "Position")

    def noise(self, scale: float, detail: float = 3.0, where: Any = None) -> Any:
        """Smooth noise about .5, ``scale`` bumps a metre."""
        given = {
            "Vector": where or self.place(),
            "Scale": scale,
            "Detail": detail,
            "Roughness": 0.65,
        }
        return self.add("ShaderNodeTexNoise", given, "Fac")


def _rgba(colour: Any) -> Any:
    return (*colour, 1.0) if isinstance(colour, tuple | list) else colour


def drawn(stage: Stage, colours: Sequence[Colour], spread: float = 0.25) -> tuple[float, ...]:
    """One of some linear colours, lighter or darker, with a tint of its own."""
    light = stage.at.uniform(1 - spread, 1 + spread)
    return tuple(
        min(0.95, max(0.0, c * light * stage.at.gauss(1, 0.06))) for c in stage.at.choice(colours)
    )


def _new(stage: Stage) -> tuple[Any, Nodes]:
    made = bpy.data.materials.new("surface")
    made.use_nodes = True
    made.node_tree.nodes.clear()
    return made, Nodes(made.node_tree)


def _finish(stage: Stage, nodes: Nodes, shader: Any) -> None:
    """The shader seen through the air: what the camera sees far away has the haze's colour."""
    ray = nodes.tree.nodes.new("ShaderNodeLightPath").outputs
    gone = nodes.math("DIVIDE", ray["Ray Length"], -stage.haze.reach)
    gone = nodes.math("SUBTRACT", 1.0, nodes.math("EXPONENT", gone))
    gone = nodes.math("MULTIPLY", gone, ray["Is Camera Ray"])
    air = nodes.add("ShaderNodeEmission", {"Color": (*stage.haze.colour, 1)})
    seen = nodes.add("ShaderNodeMixShader", {0: gone, 1: shader, 2: air})
    nodes.add("ShaderNodeOutputMaterial", {"Surface": seen})


def plain(
    stage: Stage, colour: Colour, rough: float = 0.8, metal: float = 0.0, vary: float = 0.15
) -> Material:
    """One colour, slightly varied: paint, plastic, metal."""
    made, nodes = _new(stage)
    dark = tuple(c * (1 - vary) for c in colour)
    look = nodes.mix(nodes.noise(stage.at.uniform(0.3, 3)), dark, tuple(colour))
    given = {"Base Color": look, "Roughness": rough, "Metallic": metal}
    _finish(stage, nodes, nodes.add("ShaderNodeBsdfPrincipled", given))
    return made


def lamp(stage: Stage, colour: Colour, strength: float) -> Material:
    """What shines: bulbs, tail lights, lit windows."""
    made, nodes = _new(stage)
    given = {"Color": (*colour, 1), "Strength": strength}
    nodes.add("ShaderNodeOutputMaterial", {"Surface": nodes.add("ShaderNodeEmission", given)})
    return made


def ground(
    stage: Stage,
    colour: Colour,
    other: Colour,
    grain: float,
    contrast: float = 0.25,
    bump: float = 0.3,
    patches: float = 0.4,
    rough: float = 0.95,
) -> Material:
    """Grass, earth, leaves, snow: a colour that goes over into another in patches."""
    made, nodes = _new(stage)
    fine = nodes.noise(grain, 4)
    wide = nodes.step(nodes.noise(stage.at.uniform(0.05, 0.6)), 0.5 - patches, 0.5 + patches)
    look = nodes.mix(wide, tuple(colour), tuple(other))
    look = nodes.mix(nodes.step(fine, 0.3, 0.7), _darker(nodes, look, contrast), look)
    normal = nodes.add("ShaderNodeBump", {"Strength": bump, "Distance": 0.05, "Height": fine})
    given = {"Base Color": look, "Roughness": rough, "Normal": normal}
    _finish(stage, nodes, nodes.add("ShaderNodeBsdfPrincipled", given))
    return made


def _darker(nodes: Nodes, look: Any, share: Any) -> Any:
    return nodes.mix(share, look, (0.0, 0.0, 0.0))


def paved(
    stage: Stage,
    colour: Colour,
    half: float,
    wet: float = 0.0,
    stones: float = 0.0,
    slush: Colour | None = None,
    ruts: float = 0.0,
    edge: Colour | None = None,
) -> Material:
    """A road: grain, patches, cracks, wheel tracks, frayed edges; wet, of stones, under slush.

    half: its half width in metres, the scale of the first UV. wet: share of it under water.
    stones: their size in metres. ruts: how dark or light wheel tracks are.
    """
    at = stage.at
    made, nodes = _new(stage)
    across = nodes.math("ABSOLUTE", _across(nodes))
    fine, wide = nodes.noise(at.uniform(15, 60)), nodes.noise(at.uniform(0.1, 0.5))
    look: Any = nodes.mix(
        nodes.step(wide, 0.3, 0.7), tuple(c * at.uniform(0.75, 1) for c in colour), tuple(colour)
    )
    look = nodes.mix(nodes.step(fine, 0.3, 0.75), _darker(nodes, look, at.uniform(0.1, 0.45)), look)
    if stones:
        look = _stones(nodes, look, stones, at.uniform(0.3, 0.75))
    elif at.random() < 0.3:
        look = _cracks(nodes, look, at.uniform(0.15, 0.6), at.uniform(0.004, 0.012))
    wave = nodes.math("COSINE", nodes.math("MULTIPLY", across, 6.28 / at.uniform(1.5, 1.9)))
    track = nodes.step(wave, 0.4, -0.8)
    if ruts:
        tone = (0.0, 0.0, 0.0) if ruts > 0 else (0.9, 0.85, 0.75)
        look = nodes.mix(nodes.math("MULTIPLY", track, abs(ruts)), look, tone)
    if slush:
        share = nodes.math("ADD", nodes.noise(at.uniform(0.3, 1.2)), at.uniform(-0.25, 0.25))
        share = nodes.math("SUBTRACT", share, nodes.math("MULTIPLY", track, at.uniform(0, 0.4)))
        look = nodes.mix(nodes.step(share, 0.35, 0.55), look, tuple(slush))
    if edge:
        near = nodes.math(
            "ADD", across, nodes.math("MULTIPLY", nodes.noise(at.uniform(0.5, 2)), 0.9)
        )
        look = nodes.mix(nodes.step(near, half + 0.15, half + 0.6), look, tuple(edge))
    rough: Any = at.uniform(0.6, 1)
    if wet:
        water = nodes.step(nodes.noise(at.uniform(0.1, 0.7)), 0.75 - wet * 0.6, 0.6 - wet * 0.6)
        water = nodes.math("SUBTRACT", 1.0, water)
        look = _darker(nodes, look, nodes.math("MULTIPLY", water, 0.5))
        rough = nodes.math("SUBTRACT", 0.7, nodes.math("MULTIPLY", water, at.uniform(0.45, 0.66)))
    normal = nodes.add(
        "ShaderNodeBump", {"Strength": at.uniform(0.05, 0.4), "Distance": 0.02, "Height": fine}
    )
    given = {"Base Color": look, "Roughness": rough, "Normal": normal}
    _finish(stage, nodes, nodes.add("ShaderNodeBsdfPrincipled", given))
    return made


def _across(nodes: Nodes) -> Any:
    where = nodes.add("ShaderNodeTexCoord", {}, "UV")
    return nodes.add("ShaderNodeSeparateXYZ", {0: where}, 0)


def _cells(nodes: Nodes, size: float, where: Any = None) -> Any:
    given = {"Vector": where or nodes.place(), "Scale": 1 / size}
    return nodes.add("ShaderNodeTexVoronoi", given, "Distance", feature="DISTANCE_TO_EDGE")


def _stones(nodes: Nodes, look: Any, size: float, depth: float) -> Any:
    return nodes.mix(nodes.step(_cells(nodes, size), 0.12, 0.02), look, _darker(nodes, look, depth))


def _cracks(nodes: Nodes, look: Any, often: float, wide: float) -> Any:
    """Dark lines between cells that are bent by noise, metres apart."""
    bend = nodes.add("ShaderNodeTexNoise", {"Vector": nodes.place(), "Scale": 0.8}, "Color")
    where = nodes.add("ShaderNodeVectorMath", {0: nodes.place(), 1: bend}, operation="ADD")
    line = nodes.step(_cells(nodes, 1 / often * 2, where), wide, wide / 3)
    part = nodes.step(nodes.noise(0.25, 1), 0.45, 0.6)  # not everywhere
    return nodes.mix(nodes.math("MULTIPLY", line, part), look, _darker(nodes, look, 0.6))


def facade(stage: Stage, colour: Colour) -> Material:
    """A wall with rows of windows, some of them lit at night; windows each 2 to 4 metres."""
    at = stage.at
    made, nodes = _new(stage)
    where = nodes.add("ShaderNodeTexCoord", {}, "Object")
    x, y, z = (nodes.add("ShaderNodeSeparateXYZ", {0: where}, k) for k in range(3))
    along = nodes.math("DIVIDE", nodes.math("ADD", x, y), at.uniform(2, 4))
    up = nodes.math("DIVIDE", z, at.uniform(2.6, 3.4))
    wide, tall = at.uniform(0.15, 0.4), at.uniform(0.2, 0.35)
    inside = [
        nodes.step(
            nodes.math("ABSOLUTE", nodes.math("SUBTRACT", nodes.math("FRACT", one), 0.5)),
            half,
            half - 0.03,
        )
        for one, half in ((along, wide), (up, tall))
    ]
    pane = nodes.math("MULTIPLY", *inside)
    wall = nodes.mix(nodes.noise(at.uniform(0.3, 8)), tuple(c * 0.7 for c in colour), tuple(colour))
    look = nodes.mix(pane, wall, (0.03, 0.035, 0.05))
    rough = nodes.math("SUBTRACT", 0.9, nodes.math("MULTIPLY", pane, 0.8))
    given: dict[Any, Any] = {"Base Color": look, "Roughness": rough}
    if stage.night:
        lit = nodes.step(nodes.noise(0.35, 1), 0.52, 0.56)
        given |= {
            "Emission Color": (1, 0.7, 0.35, 1),
            "Emission Strength": nodes.math("MULTIPLY", pane, nodes.math("MULTIPLY", lit, 0.4)),
        }
    _finish(stage, nodes, nodes.add("ShaderNodeBsdfPrincipled", given))
    return made
