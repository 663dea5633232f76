"""The camera: height, lens and tilt, which depend on its vehicle; and a drive through a world."""

from collections.abc import Callable
from math import atan, degrees, radians, tan
from typing import Any, NamedTuple

import bpy
from mathutils import Matrix

from train.worlds.course import SPACING, START
from train.worlds.ego_cars import Lens, put_car, put_robot
from train.worlds.fisheye import build_fisheye
from train.worlds.framing import predict_one_sided
from train.worlds.head_lights import put_head_lights
from train.worlds.plans import FISHEYES
from train.worlds.roads import UNPAVED, Road
from train.worlds.stage import HEIGHT, WIDTH, Stage
from train.worlds.truth import COLOURS, VERTICAL

SHAPES = [4 / 3, 4 / 3, 1.5, 16 / 9, 16 / 9, 1.9, 2.4, 3.3]
"""Aspect ratios (width / height) of the cameras' own images."""

LENSES = ((22, 35), (28, 42), (40, 55))
TOWN_LENSES = ((19, 28), (24, 34), (30, 44))
"""Half of the horizontal field of view in degrees, such that only the near kerb is in view."""

FRAMED, TRIES = 0.65, 40
"""Fraction of rows in which a street's far edge alone shall leave the image, and how many cameras
are sampled to get it."""

CLEAR_ACROSS, CLEAR_AHEAD = 2.2, 4.0
"""Width in metres that is cleared of objects along a drive."""


def build_camera(stage: Stage, road: Road, mount: str) -> None:
    """Place the camera on the road, its vehicle around it and, at night, its head lights."""
    if mount in FISHEYES:
        build_fisheye(stage, road, mount)
        _clear(stage, [_axes_at(road, stage.station)])
        return
    at, course = stage.at, road.course
    lens, tall, side, pitch, yaw = _sample_view(stage, road, mount)
    data: Any = bpy.data.cameras.new("camera")
    data.sensor_fit, data.clip_start, data.clip_end = "VERTICAL", 0.05, 2000
    data.angle_y = 2 * atan(lens.half_up)
    camera = stage.add("camera", data, course.at(START, side, tall))
    stage.scene.camera = camera
    slope = (course.points[START + 2].z - course.points[START].z) / 3
    yaw = radians(yaw)
    camera.rotation_euler = (radians(90 - pitch) + atan(slope), radians(at.gauss(0, 1.5)), yaw)
    if mount == "robot":
        if stage.chance(0.4):
            put_robot(stage, camera, lens)
    elif stage.chance(0.58):
        put_car(stage, camera, lens, (1, 5, 1) if mount == "truck" else (6, 3, 2))
    if stage.night and not stage.chance(0.1):
        x, y, _ = camera.location
        low = camera.location[2] - tall + min(tall - 0.1, at.uniform(0.6, 0.9))
        put_head_lights(stage, (x, y + 2.2, low), yaw * 0.3)


class View(NamedTuple):
    """A camera's lens, height and metres from the middle of the road, and degrees down and left."""

    lens: Lens
    tall: float
    side: float
    pitch: float
    yaw: float


def _sample_view(stage: Stage, road: Road, mount: str) -> View:
    """Sample a camera; of most cars in towns one that frames the street as ``FRAMED`` says."""
    at, half = stage.at, road.course.half
    framed = road.kind == "town" and mount == "car" and stage.chance(0.88)
    for _ in range(TRIES if framed else 1):
        lens = sample_lens(stage, TOWN_LENSES if road.kind == "town" else LENSES)
        tall, side = _sample_place(stage, road, mount)
        up = degrees(atan(lens.half_up))
        pitch = at.uniform(-0.1, 0.45) * up if stage.chance(0.85) else at.uniform(0.4, 0.9) * up
        if mount == "truck":
            pitch = at.uniform(0.1, 0.8) * up
        view = View(lens, tall, side, pitch, _sample_yaw(stage, road))
        edges = (half - stage.hand * side, half + stage.hand * side)
        turn = stage.hand * tan(radians(view.yaw))
        if framed and predict_one_sided(edges, tall, lens, turn, tan(radians(pitch))) > FRAMED:
            break
    return view


def _sample_place(stage: Stage, road: Road, mount: str) -> tuple[float, float]:
    """Sample the camera's height, and metres from the middle of the road."""
    at, half = stage.at, road.course.half
    narrow = road.kind in (*UNPAVED, "lane")
    side = (at.uniform(-0.25, 0.25) if narrow else at.uniform(-0.55, 0.6)) * half
    if road.lane is not None:
        side = road.lane + at.uniform(-0.3, 0.3)
    if mount == "robot":
        if road.kind == "town" and stage.chance(0.4):  # on the pavement
            side = stage.hand * (half + at.uniform(0.8, 2.2))
        return at.uniform(0.15, 0.7), side
    if mount == "truck":
        return at.uniform(2.1, 3.4), side
    return at.choice([at.uniform(1.1, 1.6), at.uniform(1.2, 2.6)]), side


def _sample_yaw(stage: Stage, road: Road) -> float:
    """Sample the camera's yaw in degrees to the left; larger where the camera's car turns off."""
    at = stage.at
    if road.lane is None:
        return at.gauss(0, 5) if stage.chance(0.85) else at.gauss(0, 18)
    if not road.open(START) and stage.chance(0.5):
        return at.uniform(-65, 65)
    # towards the lanes beyond rather than to the kerb
    return at.gauss(1.5 * stage.hand, 3) if stage.chance(0.92) else at.gauss(0, 15)


def drive_on(stage: Stage, road: Road, frames: int) -> Callable[[int], None]:
    """Return a function that moves the camera and its car to a frame of a drive, one metre a frame.

    Objects in the way are removed first.
    """
    camera = stage.scene.camera
    course = [_axes_at(road, stage.station + metres / SPACING) for metres in range(frames)]
    back = course[0].inverted()
    _clear(stage, course)
    own = [one for one in stage.scene.objects if one.name.startswith("own")]
    begun = [(one, one.matrix_world.copy()) for one in (camera, *own)]

    def bring(frame: int) -> None:
        for thing, first in begun:
            thing.matrix_world = course[frame] @ back @ first

    return bring


def _clear(stage: Stage, course: list[Any]) -> None:
    """Remove the objects in the camera's way along some axes of the road."""
    bpy.context.view_layer.update()
    across = (course[0].inverted() @ stage.scene.camera.matrix_world.translation).x
    for thing in list(stage.scene.objects):
        upright = tuple(thing.color) == (*COLOURS[VERTICAL], 1) or thing.hide_render
        if upright and thing.location.length:
            places = [step.inverted() @ thing.matrix_world.translation for step in course]
            if any(abs(at.x - across) < CLEAR_ACROSS and abs(at.y) < CLEAR_AHEAD for at in places):
                bpy.data.objects.remove(thing)


def _axes_at(road: Road, place: float) -> Any:
    """Return the axes of the road at a point of its course or between two: across, along, up."""
    index, rest = divmod(place, 1)
    here, there = (road.course.points[int(index) + step] for step in (0, 1))
    heading = road.course.headings[int(index)] * (1 - rest)
    heading += road.course.headings[int(index) + 1] * rest
    climb = atan((there.z - here.z) / SPACING)
    turn = Matrix.Rotation(-heading, 4, "Z") @ Matrix.Rotation(climb, 4, "X")
    return Matrix.Translation(here.lerp(there, rest)) @ turn


def sample_lens(stage: Stage, lenses: tuple[tuple[int, int], ...] = LENSES) -> Lens:
    """Sample a lens, narrow to wide, and an aspect ratio; set how images are squeezed."""
    at, render = stage.at, stage.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    squeeze = at.choice(SHAPES) / (WIDTH / HEIGHT)
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, squeeze), 1.0
    angle = at.choice([at.uniform(*limits) for limits in lenses])
    half_across = tan(radians(angle))
    return Lens(half_across / (WIDTH / HEIGHT * squeeze), half_across)
