"""Surround cameras: fisheyes at a car's front, rear and mirrors, tilted down, its body in view."""

from math import radians
from typing import Any, NamedTuple

import bpy
from mathutils import Matrix, Vector

from train.worlds.head_lights import put_head_lights
from train.worlds.junctions import build_block
from train.worlds.lens import SENSOR, Fisheye, angle_polynomial, sample_fisheye
from train.worlds.materials import drawn, plain
from train.worlds.roads import UNPAVED, Road
from train.worlds.stage import HEIGHT, WIDTH, Parts, Stage, box
from train.worlds.truth import EGO
from train.worlds.vehicles import PAINTS, car, van


class Mount(NamedTuple):
    """Pose of a camera on the car: metres across, along, up; degrees to the left and down."""

    place: tuple[float, float, float]
    yaw: float
    pitch: float


def build_fisheye(stage: Stage, road: Road, side: str) -> None:
    """Place a fisheye at a side of a car (or a robot) on the road, and the car around it."""
    at, course = stage.at, road.course
    index = stage.station = max(1, min(stage.station, road.length - 8))
    stage.lens = sample_fisheye(at, WIDTH, HEIGHT)
    across = at.uniform(-0.25, 0.25) if road.kind in (*UNPAVED, "lane") else at.uniform(-0.5, 0.5)
    across = road.lane if road.lane is not None else across * course.half
    turn = at.gauss(0, 0.05) if stage.chance(0.8) else at.uniform(-0.8, 0.8)
    slope = (course.points[index + 2].z - course.points[index].z) / 3
    axes = Matrix.Translation(course.at(index, across, 0.035))
    axes @= Matrix.Rotation(turn - course.heading(index), 4, "Z") @ Matrix.Rotation(slope, 4, "X")
    body = [] if side == "front" and stage.chance(0.3) else at.choice((car, car, van))(stage)
    half, end, tail = (
        max((abs(x) for (points, _), _ in body for x, _, _ in points), default=0.3),
        max((y for (points, _), _ in body for _, y, _ in points), default=0.0),
        min((y for (points, _), _ in body for _, y, _ in points), default=0.0),
    )
    mount = _sample_mount(stage, side, half, end, tail)
    if body:
        car_about = stage.put(stage.mesh([*body, *_trim(stage, side, mount)]), EGO)
        car_about.name, car_about.matrix_world = "own car", axes
    _place_camera(stage, axes, mount)
    if stage.night and not stage.chance(0.1):
        front = axes @ Vector((0, end + 0.1, 0.65))
        put_head_lights(stage, (front.x, front.y, front.z), axes.to_euler().z)
        if side == "rear":
            _put_rear_lamps(stage, axes, half, tail)
    if road.kind == "town":  # what the street comes from, seen by cameras that look behind
        build_block(stage, road, 0, 0.0, (70.0, 8.0))


def _sample_mount(stage: Stage, side: str, half: float, end: float, tail: float) -> Mount:
    """Sample the pose of a camera on a car with this half width, tail and front end."""
    at = stage.at
    pitch = at.uniform(0, 25) if stage.chance(0.5) else at.uniform(15, 60)
    if side in ("left", "right"):
        sign = -1 if side == "left" else 1
        place = (sign * (half + at.uniform(0.06, 0.2)), at.uniform(0.3, 0.9), at.uniform(0.85, 1.2))
        return Mount(place, -sign * (90 + at.gauss(0, 6)), max(pitch, at.uniform(10, 45)))
    if side == "rear":
        place = (at.uniform(-0.2, 0.2), tail - at.uniform(0.02, 0.06), at.uniform(0.65, 1.15))
        return Mount(place, 180 + at.gauss(0, 2), max(pitch, at.uniform(5, 40)))
    place = (at.uniform(-0.15, 0.15), end + at.uniform(0.02, 0.06), at.uniform(0.35, 0.9))
    return Mount(place, at.gauss(0, 2), pitch)


def _trim(stage: Stage, side: str, mount: Mount) -> Parts:
    """Return the mirror that holds a camera, or the bumper below it."""
    at, (x, y, z) = stage.at, mount.place
    look = plain(stage, drawn(stage, [*PAINTS, (0.02, 0.02, 0.02)]), at.uniform(0.1, 0.7))
    if side in ("left", "right"):
        out = 1 if x > 0 else -1
        shell = box(
            (x + out * at.uniform(-0.1, 0.08), y, z + at.uniform(0.06, 0.1)), (0.24, 0.14, 0.08)
        )
        return [(shell, look)]
    ahead = 1 if y > 0 else -1
    deep, low = at.uniform(0.0, 0.16), z - at.uniform(0.12, 0.3)
    parts: Parts = [
        (box((0, y + ahead * (deep / 2 - 0.06), low - 0.1), (1.7, deep + 0.06, 0.2)), look)
    ]
    if stage.chance(0.5):
        plate = plain(stage, (0.7, 0.7, 0.66), 0.5)
        parts.append((box((0, y + ahead * (deep - 0.02), low - 0.08), (0.5, 0.04, 0.12)), plate))
    return parts


def _place_camera(stage: Stage, axes: Any, mount: Mount) -> None:
    """Place the camera and set its lens."""
    lens: Fisheye = stage.lens
    data: Any = bpy.data.cameras.new("camera")
    data.type, data.panorama_type = "PANO", "FISHEYE_LENS_POLYNOMIAL"
    data.sensor_fit, data.clip_start, data.clip_end = "HORIZONTAL", 0.01, 2000
    data.sensor_width = SENSOR
    for k, weight in enumerate(angle_polynomial(lens)):
        setattr(data, f"fisheye_polynomial_k{k}", -weight)  # Blender counts them so
    data.fisheye_fov = radians(lens.view)
    camera = stage.scene.camera = stage.add("camera", data, (0, 0, 0))
    roll = stage.at.gauss(0, 1.5)
    spin = Matrix.Rotation(radians(mount.yaw), 4, "Z")
    spin = spin @ Matrix.Rotation(radians(90 - mount.pitch), 4, "X")
    spin = spin @ Matrix.Rotation(radians(roll), 4, "Z")
    camera.matrix_world = axes @ Matrix.Translation(mount.place) @ spin
    render = stage.scene.render
    squeeze = lens.shape / (WIDTH / HEIGHT)
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, squeeze), max(1.0, 1 / squeeze)
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    stage.mount = {"height": mount.place[2], "yaw": mount.yaw, "pitch": mount.pitch, "roll": roll}


def _put_rear_lamps(stage: Stage, axes: Any, half: float, tail: float) -> None:
    """Add the red glow of tail lights, sometimes with a white reversing light."""
    white = stage.chance(0.6)
    for side in (-0.7, 0.7):
        for colour, watts in (((1, 0.03, 0.01), 3.0), ((1, 0.95, 0.85), 25.0 * white)):
            light: Any = bpy.data.lights.new("lamp", "POINT")
            light.energy, light.color, light.shadow_soft_size = watts, colour, 0.06
            where = axes @ Vector((side * half, tail - 0.12, 0.8))
            stage.add("own lamp", light, (where.x, where.y, where.z))
