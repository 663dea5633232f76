"""The camera and the car that carries it: height, lens, tilt; bonnets, dashboards, robots."""

from collections.abc import Callable
from math import atan, degrees, radians, tan
from typing import Any, NamedTuple

import bpy
from mathutils import Matrix

from train.worlds.materials import drawn, palette, plain
from train.worlds.roads import SPACING, START, UNPAVED, Road
from train.worlds.stage import COLOURS, EGO, VERTICAL, Parts, Shape, Stage, box
from train.worlds.vehicles import PAINTS

WIDTH, HEIGHT = 384, 288
"""Of the pictures: what other shapes are squeezed to, as the networks do."""

SHAPES = [4 / 3, 4 / 3, 1.5, 16 / 9, 16 / 9, 1.9, 2.4, 3.3]
"""Width over height of the cameras' own pictures."""

CLEAR_ACROSS, CLEAR_AHEAD = 2.2, 4.0
"""Metres about the way of a drive in which nothing stands."""


class Lens(NamedTuple):
    """half_up: tangent of half the vertical field of view; half_across: of the horizontal one."""

    half_up: float
    half_across: float


def build_camera(stage: Stage, road: Road) -> None:
    """Place the camera on the road, and the car below it; its head lights at night."""
    at, course = stage.at, road.course
    robot = stage.chance(0.13)
    if robot:
        tall = at.uniform(0.3, 0.7)
    else:
        tall = at.choice([at.uniform(1.1, 1.6), at.uniform(1.2, 2.6)])
    lens = draw_lens(stage)
    data: Any = bpy.data.cameras.new("camera")
    data.sensor_fit, data.clip_start, data.clip_end = "VERTICAL", 0.05, 2000
    data.angle_y = 2 * atan(lens.half_up)
    narrow = road.kind in (*UNPAVED, "lane")
    side = at.uniform(-0.25, 0.25) if narrow else at.uniform(-0.55, 0.6)
    if road.lane is not None:
        side = (road.lane + at.uniform(-0.6, 0.6)) / course.half
    camera = stage.add("camera", data, course.at(START, side * course.half, tall))
    stage.scene.camera = camera
    up = degrees(atan(lens.half_up))
    pitch = at.uniform(-0.1, 0.45) * up if stage.chance(0.85) else at.uniform(0.4, 0.9) * up
    slope = (course.points[START + 2].z - course.points[START].z) / 3
    yaw = radians(at.gauss(0, 5) if stage.chance(0.85) else at.gauss(0, 18))
    if road.lane is not None and not road.open(START) and stage.chance(0.7):  # turning off
        yaw = radians(at.uniform(-65, 65))
    roll = radians(at.gauss(0, 1.5))
    camera.rotation_euler = (radians(90 - pitch) + atan(slope), roll, yaw)
    if robot:
        if stage.chance(0.4):
            _put_robot(stage, camera, lens)
    elif stage.chance(0.58):
        _put_car(stage, camera, lens)
    if stage.night and not stage.chance(0.1):
        _put_head_lights(stage, camera, tall)


def drive_on(stage: Stage, road: Road, frames: int) -> Callable[[int], None]:
    """What brings the camera, and the lamps of its car, to a frame of a drive, a metre each.

    What stands in the way is taken off the road first.
    """
    camera = stage.scene.camera
    bpy.context.view_layer.update()
    course = [_along(road, metres) for metres in range(frames)]
    back = course[0].inverted()
    across = (back @ camera.matrix_world.translation).x
    for thing in list(stage.scene.objects):
        if tuple(thing.color) == (*COLOURS[VERTICAL], 1) and thing.location.length:
            places = [step.inverted() @ thing.matrix_world.translation for step in course]
            if any(abs(at.x - across) < CLEAR_ACROSS and abs(at.y) < CLEAR_AHEAD for at in places):
                bpy.data.objects.remove(thing)
    lamps = [one for one in stage.scene.objects if one.name.startswith("head light")]
    begun = [(one, one.matrix_world.copy()) for one in (camera, *lamps)]

    def bring(frame: int) -> None:
        for thing, first in begun:
            thing.matrix_world = course[frame] @ back @ first

    return bring


def _along(road: Road, metres: float) -> Any:
    """The axes of the road so many metres ahead of the start: across, along, up."""
    index, rest = divmod(metres / SPACING, 1)
    here, there = (road.course.points[START + int(index) + step] for step in (0, 1))
    heading = road.course.headings[START + int(index)] * (1 - rest)
    heading += road.course.headings[START + int(index) + 1] * rest
    climb = atan((there.z - here.z) / SPACING)
    turn = Matrix.Rotation(-heading, 4, "Z") @ Matrix.Rotation(climb, 4, "X")
    return Matrix.Translation(here.lerp(there, rest)) @ turn


def draw_lens(stage: Stage) -> Lens:
    """Narrow to wide, of pictures of many shapes; sets how they are squeezed."""
    at, render = stage.at, stage.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    squeeze = at.choice(SHAPES) / (WIDTH / HEIGHT)
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, squeeze), 1.0
    angle = at.choice([at.uniform(22, 35), at.uniform(28, 42), at.uniform(40, 55)])
    half_across = tan(radians(angle))
    return Lens(half_across / (WIDTH / HEIGHT * squeeze), half_across)


def _put(stage: Stage, camera: Any, parts: Parts, smooth: bool = False) -> None:
    stage.put(stage.mesh(parts, smooth), EGO).parent = camera


def _hull(lens: Lens, edge: float, deep: float, arch: float, swell: float, lean: float) -> Shape:
    """A surface below the camera whose far edge is seen at a share of the height from below.

    In the camera's axes (x right, y up, z back). edge: the share; deep: metres to the far edge;
    arch: how much lower it is at its ends; swell: how much it rises between; lean: how much
    nearer the far edge is at its ends.
    """
    low = -(1 - 2 * edge) * lens.half_up
    wide = lens.half_across * deep * 1.5
    near, columns, rows = 0.25 * deep, 33, 14
    points, faces = [], []
    for k in range(rows):
        along = min(k / (rows - 3), 1.0)
        for j in range(columns):
            u = 2 * j / (columns - 1) - 1
            ahead = near + (deep * (1 - lean * u * u) - near) * along
            drop = arch * deep * abs(u) ** 2.5 + 0.02 * (1 - along) + 0.5 * max(k - rows + 3, 0)
            up = low * deep + swell * (1 - along) * along - drop
            points.append((u * wide, up, -ahead))
            if j and k:
                a = k * columns + j
                faces.append((a - 1, a, a - columns, a - columns - 1))
    return points, faces


def _put_car(stage: Stage, camera: Any, lens: Lens) -> None:
    """A bonnet that mirrors the road, a dashboard, or a strip of one above the other."""
    at = stage.at
    kind = at.choices(["bonnet", "dashboard", "both"], [6, 3, 2])[0]
    edge = at.uniform(0.03, 0.3) if kind == "bonnet" else at.uniform(0.08, 0.4)
    if kind != "dashboard":
        tone, rough = drawn(stage, PAINTS), at.choice([0.03, 0.12, 0.4])
        paint = plain(stage, tone, rough, at.choice([0.0, 0.4]), 0.03)
        deep, arch = at.uniform(1.1, 2.0), at.uniform(0.0, 0.35)
        hull = _hull(lens, edge, deep, arch, at.uniform(0, 0.12), at.uniform(0, 0.25))
        _put(stage, camera, [(hull, paint)], smooth=True)
        if stage.chance(0.12):  # a star or a spray nozzle upon it
            up = -(1 - 2 * edge) * lens.half_up * 1.1
            _put(stage, camera, [(box((0, up + 0.03, -1.1), (0.05, 0.1, 0.02)), paint)])
    if kind != "bonnet":
        if kind == "both":
            edge -= at.uniform(0.02, 0.08)
        tone = drawn(stage, palette("1 1 1, 4 4 4.5, 12 11 10"))
        dark = plain(stage, tone, at.uniform(0.3, 0.9))
        deep, arch = at.uniform(0.45, 0.8), at.uniform(0, 0.1)
        hull = _hull(lens, edge, deep, arch, at.uniform(0, 0.03), at.uniform(0, 0.2))
        parts: Parts = [(hull, dark)]
        for _ in range(at.choice([0, 0, 1, 2])):  # a telephone, a hood over the instruments
            across, up = at.uniform(-0.9, 0.9) * lens.half_across, -(1 - 2 * edge) * lens.half_up
            size = (at.uniform(0.04, 0.25), at.uniform(0.02, 0.07), 0.05)
            parts.append((box((across * 0.6, up * 0.6, -0.6), size), dark))
        _put(stage, camera, parts)
    if stage.chance(0.15):
        _put_pillar(stage, camera, lens)


def _put_pillar(stage: Stage, camera: Any, lens: Lens) -> None:
    """A pillar of the windscreen at one side of the picture, upright or leaning."""
    at = stage.at
    side = at.choice((-1, 1))
    out, wide = side * lens.half_across * at.uniform(0.35, 0.5), side * 0.6
    lean = side * at.uniform(0, 0.6) * lens.half_up
    points = [(out, -0.5, -0.5), (out + wide, -0.5, -0.5)]
    points += [(out + wide + lean, 0.5, -0.5), (out + lean, 0.5, -0.5)]
    look = plain(stage, drawn(stage, [*PAINTS, (0.02, 0.02, 0.02)]), at.uniform(0.1, 0.9))
    _put(stage, camera, [((points, [(0, 1, 2, 3)]), look)])


def _put_robot(stage: Stage, camera: Any, lens: Lens) -> None:
    """The front of a robot: a plate or a bar at the lower edge."""
    at = stage.at
    up = -(1 - 2 * at.uniform(0.02, 0.16)) * lens.half_up * 0.3
    look = plain(stage, drawn(stage, PAINTS), at.uniform(0.2, 0.8))
    wide = lens.half_across * at.uniform(0.2, 0.8)
    _put(stage, camera, [(box((at.uniform(-0.1, 0.1), up - 0.1, -0.3), (wide, 0.2, 0.1)), look)])


def _put_head_lights(stage: Stage, camera: Any, tall: float) -> None:
    """Two beams ahead, from below the camera."""
    at, (x, y, z) = stage.at, camera.location
    low, watts = min(tall - 0.1, 0.75) - tall, at.uniform(200, 1500)
    spread, tilt = radians(at.uniform(28, 70)), radians(at.uniform(0.5, 3.5))
    for side in (-0.6, 0.6):
        light: Any = bpy.data.lights.new("head light", "SPOT")
        light.energy, light.spot_size, light.spot_blend = watts, spread, at.uniform(0.5, 1)
        light.color, light.shadow_soft_size = (1, at.uniform(0.8, 0.95), at.uniform(0.6, 0.9)), 0.08
        thing = stage.add("head light", light, (x + side, y + 2.2, z + low))
        thing.rotation_euler = (radians(90) - tilt, 0, camera.rotation_euler[2] * 0.3)
