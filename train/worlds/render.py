"""A world from its number: the scene built of its parts, rendered, developed, with its truth."""

import os
from pathlib import Path
from random import Random
from typing import Any

os.environ["OPENCV_IO_ENABLE_OPENEXR"] = "1"  # before cv2

import cv2
import numpy as np

from train.worlds.blender import bpy
from train.worlds.camera import build_camera, sample_across
from train.worlds.fisheye import build_fisheye
from train.worlds.ground import build_ground
from train.worlds.lens import image_circle, write_lens
from train.worlds.light import build_sky, sample_light, sample_weather
from train.worlds.marks import mark_road
from train.worlds.materials import Nodes
from train.worlds.nowhere import PLACES, build_place
from train.worlds.plans import FISHEYES, RIDERS, plan_world
from train.worlds.road import BEHIND, START
from train.worlds.scene import Scene
from train.worlds.sensor import Exposure, Photo, develop
from train.worlds.sides import build_sides
from train.worlds.traffic import populate
from train.worlds.truth import COLOURS, settle_truth

SAMPLES = 2
"""Paths a pixel; the rest is the denoiser's."""

FINE = 3
"""Paths through each pixel of the truth, across and down."""


def build_world(number: int) -> tuple[Scene, str, float]:
    """Build the scene of a number; return it, its name and the camera's speed, 0 to 1."""
    plan, rng = plan_world(number), Random(number)
    scene = Scene(rng, plan.hand)
    scene.looks_back = plan.mount in FISHEYES
    scene.station = START + BEHIND * scene.looks_back
    kind = scene.pick(plan.ground)
    sample_light(scene, plan.light)
    if kind not in PLACES:
        sample_weather(scene, plan.weather)
    build_sky(scene)
    if kind in PLACES:
        build_place(scene, kind)
    else:
        road = build_ground(scene, kind)
        scene.station = max(1, min(scene.station, road.length - 8))
        road.camera = sample_across(scene, road, plan.mount)
        mark_road(scene, road)
        build_sides(scene, road)
        populate(scene, road, bool(plan.crowd))
        build = build_fisheye if scene.looks_back else build_camera
        build(scene, road, plan.mount)
    speed = rng.random() * scene.chance(0.45 if plan.mount in RIDERS else 0.06)
    return scene, f"{number:05d}_{plan.name or kind}_{scene.light}", speed


def render_world(number: int, folder: Path) -> tuple[str, Photo, str]:
    """Render a world, writing its passes to a folder; return name, photo, a fisheye's TOML text."""
    scene, name, speed = build_world(number)
    light = _render_light(scene, number, folder)
    truth = _render_truth(scene, folder)
    circle = image_circle(scene.lens) if scene.lens else None
    exposure = Exposure(scene.light, scene.falling, speed * (not scene.lens), circle)
    photo = develop(light, truth, exposure, np.random.default_rng([35, number]))
    return name, photo, write_lens(scene.lens, scene.mount) if scene.lens else ""


def _render_light(scene: Scene, number: int, folder: Path) -> np.ndarray:
    """Render linear light float32 (288, 384, 3) BGR."""
    blender, cycles = scene.blender, scene.blender.cycles
    blender.render.engine = "CYCLES"
    blender.render.threads_mode, blender.render.threads = "FIXED", 1
    cycles.samples, cycles.seed, cycles.max_bounces = SAMPLES, number, 3
    cycles.diffuse_bounces, cycles.glossy_bounces = 1, 2
    # many lamps; without any it costs a third
    cycles.use_light_tree = any(thing.type == "LIGHT" for thing in blender.objects)
    cycles.use_denoising, cycles.denoiser = True, "OPENIMAGEDENOISE"
    cycles.denoising_prefilter = "FAST"  # a fifth of the time less
    cycles.sample_clamp_indirect = 10.0
    blender.render.image_settings.file_format = "OPEN_EXR"
    return _render_pass(blender, folder / f"light{os.getpid()}.exr")


def _render_truth(scene: Scene, folder: Path) -> np.ndarray:
    """Render what each pixel is, uint8 (288, 384): flat colours, several paths through each pixel.

    The scene has no light any more afterwards.
    """
    blender, cycles = scene.blender, scene.blender.cycles
    nodes = Nodes(bpy.data.materials.new("truth"))
    colour = nodes.add("ShaderNodeObjectInfo", {}, "Color")
    nodes.add("ShaderNodeOutputMaterial", {"Surface": nodes.emit(colour, 1.0)})
    blender.view_layers[0].material_override = nodes.owner
    for thing in blender.objects:
        thing.hide_render = thing.type == "LIGHT"  # what only the truth shows was hidden before
    blender.world = None
    blender.render.resolution_percentage = 100 * FINE
    cycles.samples, cycles.use_denoising, cycles.max_bounces = 1, False, 0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 0.01
    colours = _render_pass(blender, folder / f"truth{os.getpid()}.exr")[..., ::-1] > 0.5
    codes = np.zeros(colours.shape[:2], np.uint8)
    for code, colour in COLOURS.items():
        codes[(colours == np.array(colour, bool)).all(2)] = code
    return settle_truth(codes, FINE)


def _render_pass(blender: Any, path: Path) -> np.ndarray:
    blender.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))[..., :3].astype(np.float32)
    path.unlink()
    return image
