"""Time of day and weather: sun, clouds, dusk, night, and haze."""

from collections.abc import Mapping
from math import pi, radians
from typing import Any

import bpy

from train.worlds.materials import Nodes
from train.worlds.photographs import lay_sky
from train.worlds.stage import Haze, Stage

FOG = 130
"""Visibility in metres below which haze also hides the lower part of the sky."""


def sample_hour(stage: Stage, hours: Mapping[str, int]) -> str:
    """Sample a time of day; set haze and whether lamps are lit. Called before any material."""
    at = stage.at
    hour = at.choices(list(hours), list(hours.values()))[0]
    stage.hour = hour
    reach = at.choice([8000, 3000, 1200, 400] if hour != "overcast" else [4000, 1500, 600, 180])
    if stage.night:
        stage.haze = Haze(reach * 2, (0.002, 0.002, 0.003))
    else:
        light = at.uniform(0.35, 0.9) if hour != "dusk" else at.uniform(0.05, 0.2)
        colour = (light * at.uniform(0.9, 1.05), light, light * at.uniform(1, 1.15))
        stage.haze = Haze(reach, colour)
    return hour


def sample_weather(stage: Stage, wet: bool | None) -> None:
    """Sample fog with a visibility of some tens of metres, and falling rain or snow.

    wet: whether it rains on a wet road; None samples both.
    """
    at, stage.wet = stage.at, wet
    if stage.chance(0.35 if wet else 0.18):
        stage.haze = stage.haze._replace(reach=at.uniform(FOG / 5, FOG))
    if stage.chance(0.2 if wet is None else 0.8 * wet):
        stage.falling = at.uniform(0.1, 1)


def build_light(stage: Stage, hour: str) -> None:
    """Build sky and sun, or a dark sky."""
    at = stage.at
    world: Any = bpy.data.worlds.new("sky")
    stage.scene.world = world
    # the map of where light comes from costs seconds at its own choice of size
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 256
    nodes = Nodes(world)
    strength = 1.0
    if hour == "night":
        look: Any = tuple(at.uniform(0.4, 1) * c for c in (0.004, 0.004, 0.006))
        if stage.chance(0.4):
            look = tuple(at.uniform(4, 14) * c for c in look)
    elif hour == "overcast":
        tone = at.uniform(0.5, 0.9)
        bright = (tone, tone * at.uniform(0.97, 1.02), tone * at.uniform(0.98, 1.12))
        dark = tuple(c * at.uniform(0.5, 0.95) for c in bright)
        look = nodes.mix(_clouds(stage, nodes), dark, bright)
    else:
        sky: dict[str, Any] = {"sky_type": "MULTIPLE_SCATTERING"}
        sky["sun_elevation"] = radians(at.uniform(0, 6) if hour == "dusk" else at.uniform(8, 70))
        sky |= {"sun_rotation": at.uniform(0, 2 * pi), "air_density": at.uniform(0.7, 2.5)}
        look = nodes.add("ShaderNodeTexSky", {}, **sky)
        strength = 0.15
        if stage.chance(0.6):
            white = at.uniform(1.5, 6) * (0.15 if hour == "dusk" else 1)
            share = nodes.math("MULTIPLY", _clouds(stage, nodes), at.uniform(0.4, 1))
            look = nodes.mix(share, look, (white, white, white * 1.03))
    look, strength = lay_sky(stage, nodes) or (look, strength)
    given = {"Color": (*look, 1) if isinstance(look, tuple) else look, "Strength": strength}
    background = nodes.add("ShaderNodeBackground", given)
    if stage.haze.reach < FOG:
        where = nodes.add("ShaderNodeTexCoord", {}, "Generated")
        low = nodes.step(nodes.add("ShaderNodeSeparateXYZ", {0: where}, 2), 0.6, 0.1)
        fog = nodes.add("ShaderNodeBackground", {"Color": (*stage.haze.colour, 1)})
        background = nodes.add("ShaderNodeMixShader", {0: low, 1: background, 2: fog})
    nodes.add("ShaderNodeOutputWorld", {"Surface": background})


def _clouds(stage: Stage, nodes: Nodes) -> Any:
    """Return the density of clouds, 0 to 1: noise over directions, flat at the horizon."""
    at = stage.at
    where = nodes.add("ShaderNodeTexCoord", {}, "Generated")
    flat = nodes.add("ShaderNodeMapping", {0: where, "Scale": (1, 1, at.uniform(2, 5))})
    low = at.uniform(0.35, 0.6)
    return nodes.step(nodes.noise(at.uniform(1, 5), 4, flat), low, low + at.uniform(0.05, 0.3))
