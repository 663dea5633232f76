"""Light and weather: sun, clouds, dusk, night; haze, rain, water on the ground."""

from math import pi, radians
from typing import Any

from train.worlds.blender import bpy
from train.worlds.materials import Nodes
from train.worlds.plans import Weights
from train.worlds.scene import Haze, Scene
from train.worlds.tables import read_table

WEATHER = {row["weather"]: row for row in read_table("weather")}
FOG = 130
"""Visibility in metres below which haze also hides the lower part of the sky."""


def sample_light(scene: Scene, weights: Weights) -> None:
    """Sample a light; set haze and whether lamps are lit. Called before any material."""
    rng = scene.rng
    scene.light = scene.pick(weights)
    if scene.night:
        reach = rng.choice([16000, 6000, 2400, 800])
        scene.haze = Haze(reach, (0.002, 0.002, 0.003))
        return
    cloudy = scene.light == "overcast"
    reach = rng.choice([4000, 1500, 600, 180] if cloudy else [8000, 3000, 1200, 400])
    bright = rng.uniform(0.05, 0.2) if scene.light == "dusk" else rng.uniform(0.35, 0.9)
    colour = (bright * rng.uniform(0.9, 1.05), bright, bright * rng.uniform(1, 1.15))
    scene.haze = Haze(reach, colour)


def sample_weather(scene: Scene, weather: str) -> None:
    """Sample water on the ground, fog with a visibility of tens of metres, rain or snow."""
    rng, row = scene.rng, WEATHER[weather]
    if scene.chance(row["wet"]):
        scene.water = scene.between(row["water"])
    if scene.chance(row["fog"]):
        scene.haze = scene.haze._replace(reach=rng.uniform(FOG / 5, FOG))
    if scene.chance(row["fall"]):
        scene.falling = rng.uniform(0.1, 1)


def build_sky(scene: Scene) -> None:
    """Build sky and sun, or a dark sky."""
    rng, dusk = scene.rng, scene.light == "dusk"
    world = scene.blender.world = bpy.data.worlds.new("sky")
    # the map of where light comes from costs seconds at its own choice of size
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 256
    nodes = Nodes(world)
    strength = 1.0
    if scene.night:
        gain = rng.uniform(0.4, 1) * (rng.uniform(4, 14) if scene.chance(0.4) else 1)
        colour: Any = (0.004 * gain, 0.004 * gain, 0.006 * gain)
    elif scene.light == "overcast":
        tone = rng.uniform(0.5, 0.9)
        bright = (tone, tone * rng.uniform(0.97, 1.02), tone * rng.uniform(0.98, 1.12))
        dark = tuple(c * rng.uniform(0.5, 0.95) for c in bright)
        colour = nodes.mix(_cloud_density(scene, nodes), dark, bright)
    else:
        up = radians(rng.uniform(0, 6) if dusk else rng.uniform(8, 70))
        sun = {"sun_rotation": rng.uniform(0, 2 * pi), "sun_elevation": up}
        sun |= {"air_density": rng.uniform(0.7, 2.5)}
        colour = nodes.add("ShaderNodeTexSky", {}, sky_type="MULTIPLE_SCATTERING", **sun)
        strength = 0.15
        if scene.chance(0.6):
            white = rng.uniform(1.5, 6) * (0.15 if dusk else 1)
            density = nodes.math("MULTIPLY", _cloud_density(scene, nodes), rng.uniform(0.4, 1))
            colour = nodes.mix(density, colour, (white, white, white * 1.03))
    background = nodes.emit(colour, strength, "ShaderNodeBackground")
    if scene.haze.reach < FOG:
        direction = nodes.add("ShaderNodeTexCoord", {}, "Generated")
        low = nodes.step(nodes.split(direction, 2), 0.6, 0.1)
        fog = nodes.emit(scene.haze.colour, 1.0, "ShaderNodeBackground")
        background = nodes.add("ShaderNodeMixShader", {0: low, 1: background, 2: fog})
    nodes.add("ShaderNodeOutputWorld", {"Surface": background})


def _cloud_density(scene: Scene, nodes: Nodes) -> Any:
    """Return the density of clouds, 0 to 1: noise over directions, flat at the horizon."""
    rng = scene.rng
    direction = nodes.add("ShaderNodeTexCoord", {}, "Generated")
    flat = nodes.add("ShaderNodeMapping", {0: direction, "Scale": (1, 1, rng.uniform(2, 5))})
    low = rng.uniform(0.35, 0.6)
    return nodes.step(nodes.noise(rng.uniform(1, 5), 4, flat), low, low + rng.uniform(0.05, 0.3))
