"""Materials: colour variation, grain, cracks, stones, leaves, water, snow, windows."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from train.worlds.blender import bpy
from train.worlds.plans import Weights
from train.worlds.scene import Material, Scene
from train.worlds.tables import read_column

Colour = Sequence[float]
"""Linear RGB, 0 to 1."""
Tones = str | Sequence[Colour]
"""Colours to sample from, or "NAME NAME" of colours.csv."""

BLACK = (0.0, 0.0, 0.0)


COLOURS: dict[str, str] = read_column("colours", "percent")
"""Colours by what has them, in percent, separated by ";"."""


def sample_colour(scene: Scene, tones: Tones, spread: float = 0.25) -> tuple[float, ...]:
    """Sample one of some colours, with random brightness and tint."""
    rng, light = scene.rng, scene.rng.uniform(1 - spread, 1 + spread)
    if isinstance(tones, str):
        rows = ";".join(COLOURS[name] for name in tones.split()).split(";")
        tones = [[float(part) / 100 for part in row.split()] for row in rows]
    return tuple(min(0.95, max(0.0, c * light * rng.gauss(1, 0.06))) for c in rng.choice(tones))


def scale(colour: Colour, by: float) -> tuple[float, ...]:
    """Return a brighter or darker colour."""
    return tuple(part * by for part in colour)


class Nodes:
    """Node graph of a material or world: each call adds a node and returns its first output."""

    def __init__(self, owner: Any) -> None:
        owner.use_nodes = True
        self.owner, self.tree = owner, owner.node_tree
        self.tree.nodes.clear()

    def add(self, kind: str, inputs: dict[Any, Any], output: Any = 0, **properties: Any) -> Any:
        """Add a node; inputs by name or number, values or other nodes' sockets."""
        node = self.tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(node, name, value)
        for name, value in inputs.items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[name])
            else:
                node.inputs[name].default_value = value
        return node.outputs[output] if node.outputs else None

    def math(self, operation: str, a: Any, b: Any = 0.0) -> Any:
        """Combine two numbers by an operation."""
        return self.add("ShaderNodeMath", {0: a, 1: b}, operation=operation)

    def mix(self, fraction: Any, a: Any, b: Any) -> Any:
        """Mix colours: b by a fraction, a for the rest."""
        a, b = ((*part, 1.0) if isinstance(part, tuple | list) else part for part in (a, b))
        return self.add("ShaderNodeMix", {0: fraction, 6: a, 7: b}, 2, data_type="RGBA")

    def step(self, value: Any, low: float, high: float) -> Any:
        """Return 0 below low and 1 above high (or reversed), smooth between."""
        inputs = {0: value, 1: low, 2: high, 3: 0.0, 4: 1.0}
        return self.add("ShaderNodeMapRange", inputs, interpolation_type="SMOOTHSTEP")

    def split(self, vector: Any, axis: int) -> Any:
        """Return one coordinate of a vector."""
        return self.add("ShaderNodeSeparateXYZ", {0: vector}, axis)

    def position(self) -> Any:
        """Return the position in the world, in metres."""
        return self.add("ShaderNodeNewGeometry", {}, "Position")

    def noise(self, bumps: float, detail: float = 3.0, position: Any = None) -> Any:
        """Return smooth noise about .5 with some bumps a metre."""
        inputs = {"Vector": position or self.position(), "Scale": bumps, "Detail": detail}
        return self.add("ShaderNodeTexNoise", inputs | {"Roughness": 0.65}, "Fac")

    def cells(self, size: float, position: Any = None) -> Any:
        """Return the distance to the edge of irregular cells, in metres over size."""
        inputs = {"Vector": position or self.position(), "Scale": 1 / size}
        return self.add("ShaderNodeTexVoronoi", inputs, "Distance", feature="DISTANCE_TO_EDGE")

    def bump(self, height: Any, strength: float, distance: float) -> Any:
        """Return the normals of an uneven surface."""
        inputs = {"Strength": strength, "Distance": distance, "Height": height}
        return self.add("ShaderNodeBump", inputs)

    def emit(self, colour: Any, strength: Any, kind: str = "ShaderNodeEmission") -> Any:
        """Return a shader that emits light, of a material or, as a background, of the sky."""
        colour = (*colour, 1) if isinstance(colour, tuple | list) else colour
        return self.add(kind, {"Color": colour, "Strength": strength})


def new_surface() -> Nodes:
    """Return the graph of a new material."""
    return Nodes(bpy.data.materials.new("surface"))


def finish(scene: Scene, nodes: Nodes, colour: Any, rough: Any, **inputs: Any) -> Material:
    """Finish a material: add haze, whose colour hides it with distance.

    inputs: further inputs of the shader, such as ``Normal``.
    """
    named = {name.replace("_", " "): value for name, value in inputs.items()}
    surface = {"Base Color": colour, "Roughness": rough, **named}
    shader = nodes.add("ShaderNodeBsdfPrincipled", surface)
    ray = nodes.tree.nodes.new("ShaderNodeLightPath").outputs
    clear = nodes.math("EXPONENT", nodes.math("DIVIDE", ray["Ray Length"], -scene.haze.reach))
    hidden = nodes.math("MULTIPLY", nodes.math("SUBTRACT", 1.0, clear), ray["Is Camera Ray"])
    air = nodes.emit(scene.haze.colour, 1.0)
    visible = nodes.add("ShaderNodeMixShader", {0: hidden, 1: shader, 2: air})
    nodes.add("ShaderNodeOutputMaterial", {"Surface": visible})
    return nodes.owner


def plain(
    scene: Scene, colour: str | Colour, rough: float = 0.8, metal: float = 0.0, vary: float = 0.15
) -> Material:
    """Return a material of one slightly varied colour: paint, plastic, metal."""
    nodes = new_surface()
    colour = sample_colour(scene, colour) if isinstance(colour, str) else colour
    noise = nodes.noise(scene.rng.uniform(0.3, 3))
    mixed = nodes.mix(noise, scale(colour, 1 - vary), tuple(colour))
    return finish(scene, nodes, mixed, rough, Metallic=metal)


def lamp(colour: Colour, strength: float) -> Material:
    """Return an emitting material: bulbs, tail lights, lit windows."""
    nodes = new_surface()
    nodes.add("ShaderNodeOutputMaterial", {"Surface": nodes.emit(tuple(colour), strength)})
    return nodes.owner


class Soil(NamedTuple):
    """Natural ground in patches of two colours; leaves: the fraction under fallen leaves."""

    first: Colour
    second: Colour
    grain: float
    contrast: float
    leaves: float = 0.0


def sample_soil(scene: Scene, tones: Tones, second_tones: Tones = "") -> Soil:
    """Sample natural ground."""
    first, second = sample_colour(scene, tones), sample_colour(scene, second_tones or tones)
    return Soil(first, second, scene.rng.uniform(1, 12), scene.rng.uniform(0.15, 0.6))


def ground(
    scene: Scene, soil: Soil, bump: float = 0.3, bare: Colour = (), wear: Sequence[float] = ()
) -> Material:
    """Return grass, earth, leaves or snow: patches of two colours with soft transitions.

    wear: fractions of ``bare`` over the whole width, and in the two wheel tracks.
    """
    rng, nodes = scene.rng, new_surface()
    fine = nodes.noise(soil.grain, 4)
    wide = nodes.step(nodes.noise(rng.uniform(0.05, 0.6)), 0.1, 0.9)
    colour = nodes.mix(wide, tuple(soil.first), tuple(soil.second))
    colour = nodes.mix(nodes.step(fine, 0.3, 0.7), nodes.mix(soil.contrast, colour, BLACK), colour)
    worn: Any = 0.0
    if wear:
        track = nodes.math("MULTIPLY", _wheel_tracks(scene, nodes, _across(nodes)), wear[1])
        track = nodes.math("ADD", track, wear[0])
        patchy = nodes.step(nodes.noise(rng.uniform(0.4, 2)), 0.2, 0.7)
        worn = nodes.math("MULTIPLY", track, patchy)
        colour = nodes.mix(worn, colour, tuple(bare))
    if soil.leaves:
        colour = _leaves(scene, nodes, colour, soil.leaves, worn)
    return finish(scene, nodes, colour, 0.95, Normal=nodes.bump(fine, bump, 0.05))


def _leaves(scene: Scene, nodes: Nodes, colour: Any, cover: float, worn: Any) -> Any:
    """Strew fallen leaves over a fraction of the ground, fewer where it is worn."""
    rng = scene.rng
    for size in (rng.uniform(0.05, 0.09), rng.uniform(0.07, 0.14)):
        inputs = {"Vector": nodes.position(), "Scale": 1 / size}
        cell = nodes.add("ShaderNodeTexVoronoi", inputs, "Color")
        kind, lies = nodes.split(cell, 0), nodes.split(cell, 1)
        first, second, third = (tuple(sample_colour(scene, "leaves", 0.35)) for _ in range(3))
        leaf = nodes.mix(nodes.step(kind, 0.3, 0.32), first, second)
        leaf = nodes.mix(nodes.step(kind, 0.7, 0.72), leaf, third)
        leaf = nodes.mix(nodes.step(nodes.cells(size), 0.09, 0.02), leaf, scale(first, 0.3))
        density = nodes.math("SUBTRACT", cover, nodes.math("MULTIPLY", worn, cover * 0.9))
        heaped = nodes.math("MULTIPLY", nodes.noise(rng.uniform(0.3, 1.5)), 0.8)
        heaped = nodes.math("ADD", nodes.math("ADD", density, heaped), -0.4)
        lies = nodes.math("SUBTRACT", heaped, lies)
        colour = nodes.mix(nodes.step(lies, -0.01, 0.01), colour, leaf)
    return colour


def _across(nodes: Nodes) -> Any:
    """Return the offset from the middle of the road in metres, the first UV coordinate."""
    uv = nodes.add("ShaderNodeTexCoord", {}, "UV")
    return nodes.math("ABSOLUTE", nodes.split(uv, 0))


def _wheel_tracks(scene: Scene, nodes: Nodes, across: Any) -> Any:
    """Return the wear by wheels, 0 to 1."""
    gauge = scene.rng.uniform(1.5, 1.9)
    wave = nodes.math("COSINE", nodes.math("MULTIPLY", across, 6.28 / gauge))
    return nodes.step(wave, 0.4, -0.8)


class Paving(NamedTuple):
    """Properties of a paved surface.

    colour: of the surface; pattern: "asphalt", "cobbles", "setts" or "slabs"; size: of its stones
    in metres. water: 0 dry, 1 wet all over, more is mirror-like. slush: colour of snow, if any.
    """

    colour: Colour
    pattern: str = "asphalt"
    size: float = 0.0
    water: float = 0.0
    slush: Colour = ()


SIZES = {"asphalt": (0, 0), "cobbles": (0.06, 0.25), "setts": (0.1, 0.26), "slabs": (0.2, 0.9)}
"""Sizes in metres of the stones of each pattern, from … to."""


def sample_paving(scene: Scene, tones: Tones, patterns: Weights, slush: Colour = ()) -> Paving:
    """Sample a paved surface with the weather's water."""
    pattern = scene.pick(patterns)
    size = scene.between(SIZES[pattern])
    return Paving(sample_colour(scene, tones), pattern, size, scene.water, slush)


def sample_grey(scene: Scene) -> tuple[float, ...]:
    """Sample a colour of asphalt."""
    tone = scene.rng.uniform(0.04, 0.34)
    return tuple(tone * scene.rng.uniform(0.95, 1.05) for _ in range(3))


def pave(
    scene: Scene, paving: Paving, half: float = 99.0, ruts: float = 0.0, edge: Colour = ()
) -> Material:
    """Return a paved surface: grain, patches, stones, cracks, wheel tracks, edges; wet, slush.

    half: its half width in metres, the scale of the first UV coordinate. ruts: brightness of wheel
    tracks. edge: colour of what frays its edges.
    """
    rng, nodes = scene.rng, new_surface()
    across = _across(nodes)
    fine, wide = nodes.noise(rng.uniform(15, 60)), nodes.noise(rng.uniform(0.1, 0.5))
    dark = scale(paving.colour, rng.uniform(0.75, 1))
    colour: Any = nodes.mix(nodes.step(wide, 0.3, 0.7), dark, tuple(paving.colour))
    colour = _stones(scene, nodes, paving, colour)
    gritty = nodes.mix(rng.uniform(0.1, 0.45), colour, BLACK)
    colour = nodes.mix(nodes.step(fine, 0.3, 0.75), gritty, colour)
    if not paving.size and scene.chance(0.3):
        colour = _cracks(nodes, colour, rng.uniform(0.15, 0.6), rng.uniform(0.004, 0.012))
    track = _wheel_tracks(scene, nodes, across)
    if ruts:
        tone = BLACK if ruts > 0 else (0.9, 0.85, 0.75)
        colour = nodes.mix(nodes.math("MULTIPLY", track, abs(ruts)), colour, tone)
    if paving.slush:
        lies = nodes.math("ADD", nodes.noise(rng.uniform(0.3, 1.2)), rng.uniform(-0.2, 0.28))
        swept = nodes.math("MULTIPLY", track, rng.uniform(0, 0.4) * (half < 99))
        lies = nodes.step(nodes.math("SUBTRACT", lies, swept), 0.35, 0.55)
        colour = nodes.mix(lies, colour, tuple(paving.slush))
    if edge:
        frayed = nodes.math("MULTIPLY", nodes.noise(rng.uniform(0.5, 2)), 0.9)
        near = nodes.step(nodes.math("ADD", across, frayed), half + 0.15, half + 0.6)
        colour = nodes.mix(near, colour, tuple(edge))
    rough: Any = rng.uniform(0.6, 1)
    uneven = rng.uniform(0.05, 0.4)
    if paving.water:
        colour, rough = _flood(nodes, colour, rng.uniform(0.1, 0.7), paving.water)
        uneven *= max(0.06, 1 - 0.7 * paving.water)
    return finish(scene, nodes, colour, rough, Normal=nodes.bump(fine, uneven, 0.02))


def _stones(scene: Scene, nodes: Nodes, paving: Paving, colour: Any) -> Any:
    """Return the colour of cobbles, setts in courses or slabs, with their joints."""
    rng, size = scene.rng, paving.size
    if paving.pattern == "cobbles":
        joints = nodes.step(nodes.cells(size), 0.12, 0.02)
        return nodes.mix(joints, colour, nodes.mix(rng.uniform(0.3, 0.75), colour, BLACK))
    if not size:
        return colour
    setts = paving.pattern == "setts"
    x, y = (nodes.split(nodes.position(), axis) for axis in (0, 1))
    if setts and scene.chance(0.5):  # laid in arcs
        wave = nodes.math("SINE", nodes.math("MULTIPLY", x, 6.28 / rng.uniform(1.1, 1.9)))
        y = nodes.math("ADD", y, nodes.math("MULTIPLY", wave, rng.uniform(0.1, 0.3)))
    turn = rng.choice([0.0, 0.0, 1.57, 0.785])
    flat = nodes.add("ShaderNodeCombineXYZ", {0: x, 1: y})
    flat = nodes.add("ShaderNodeMapping", {0: flat, "Rotation": (0, 0, turn)})
    light, shade = paving.colour, scale(paving.colour, rng.uniform(0.55 if setts else 0.7, 1))
    row = size * (rng.uniform(0.7, 1.0) if setts else rng.choice([0.5, 1.0]))
    inputs = {
        **{"Vector": flat, "Scale": 1.0, "Bias": rng.uniform(-0.6, 0.6)},
        **{"Brick Width": size, "Row Height": row},
        "Mortar Size": rng.uniform(0.008, 0.02) if setts else rng.uniform(0.004, 0.015),
        **{"Color1": (*light, 1), "Color2": (*shade, 1)},
        "Mortar": (*scale(light, rng.uniform(0.35, 0.6) if scene.chance(0.85) else 1.3), 1),
    }
    offset = 0.5 if setts else rng.choice([0.0, 0.5])
    stones = nodes.add("ShaderNodeTexBrick", inputs, "Color", offset=offset)
    stain = nodes.step(nodes.noise(rng.uniform(0.3, 2)), 0.35, 0.65)
    return nodes.mix(nodes.math("MULTIPLY", stain, rng.uniform(0, 0.4)), stones, BLACK)


def _flood(nodes: Nodes, colour: Any, grain: float, water: float) -> tuple[Any, Any]:
    """Darken and smooth a fraction of a surface where water is; return colour and roughness."""
    level = 0.75 - water * 0.6
    dry = nodes.step(nodes.noise(grain), level, level - 0.15)
    film = nodes.math("SUBTRACT", 1.0, dry)
    colour = nodes.mix(nodes.math("MULTIPLY", film, 0.5), colour, BLACK)
    shine = 0.45 + 0.2 * min(water, 1.2)
    return colour, nodes.math("SUBTRACT", 0.72, nodes.math("MULTIPLY", film, shine))


def _cracks(nodes: Nodes, colour: Any, often: float, wide: float) -> Any:
    """Return dark lines between cells distorted by noise, metres apart."""
    bend = nodes.add("ShaderNodeTexNoise", {"Vector": nodes.position(), "Scale": 0.8}, "Color")
    inputs = {0: nodes.position(), 1: bend}
    position = nodes.add("ShaderNodeVectorMath", inputs, operation="ADD")
    line = nodes.step(nodes.cells(1 / often * 2, position), wide, wide / 3)
    part = nodes.step(nodes.noise(0.25, 1), 0.45, 0.6)  # not everywhere
    return nodes.mix(nodes.math("MULTIPLY", line, part), colour, nodes.mix(0.6, colour, BLACK))


def facade(scene: Scene) -> Material:
    """Return a wall with rows of windows every 2 to 4 metres, some lit at night."""
    rng, nodes, colour = scene.rng, new_surface(), sample_colour(scene, "wall")
    position = nodes.add("ShaderNodeTexCoord", {}, "Object")
    x, y, z = (nodes.split(position, axis) for axis in range(3))
    along = nodes.math("DIVIDE", nodes.math("ADD", x, y), rng.uniform(2, 4))
    up = nodes.math("DIVIDE", z, rng.uniform(2.6, 3.4))
    inside = []
    for grid, half in ((along, rng.uniform(0.15, 0.4)), (up, rng.uniform(0.2, 0.35))):
        off = nodes.math("SUBTRACT", nodes.math("FRACT", grid), 0.5)
        inside.append(nodes.step(nodes.math("ABSOLUTE", off), half, half - 0.03))
    pane = nodes.math("MULTIPLY", *inside)
    wall = nodes.mix(nodes.noise(rng.uniform(0.3, 8)), scale(colour, 0.7), tuple(colour))
    mixed = nodes.mix(pane, wall, (0.03, 0.035, 0.05))
    rough = nodes.math("SUBTRACT", 0.9, nodes.math("MULTIPLY", pane, 0.8))
    if not scene.night:
        return finish(scene, nodes, mixed, rough)
    lit = nodes.math("MULTIPLY", nodes.step(nodes.noise(0.35, 1), 0.52, 0.56), 0.4)
    strength = nodes.math("MULTIPLY", pane, lit)
    warm = (1, 0.7, 0.35, 1)
    return finish(scene, nodes, mixed, rough, Emission_Color=warm, Emission_Strength=strength)
