"""Cameras of cars, trucks, robots, motorcycles and bicycles: their place, lens and tilt."""

from math import atan, degrees, radians, tan
from typing import Any

from train.worlds.blender import Matrix, bpy
from train.worlds.ego import Lens, put_body
from train.worlds.plans import FISHEYES, RIDERS
from train.worlds.road import NARROW, SPACING, START, Limits, Road
from train.worlds.scene import HEIGHT, WIDTH, Point, Scene
from train.worlds.tables import read_table
from train.worlds.truth import COLOURS, VERTICAL

SHAPES = [4 / 3, 4 / 3, 1.5, 16 / 9, 16 / 9, 1.9, 2.4, 3.3]
"""Aspect ratios (width / height) of the cameras' own images."""

LENSES = ((22, 35), (28, 42), (40, 55))
TOWN_LENSES = ((19, 28), (24, 34), (30, 44))
"""Half of the horizontal field of view in degrees, such that only the near kerb is in view."""


MOUNTS = {row["mount"]: row for row in read_table("mounts")}
"""Ranges of a camera's height in metres, two equally likely, and pitch, in halves of its field of
view; the standard deviation of its roll in degrees; the probability that its vehicle is in view."""


def build_camera(scene: Scene, road: Road, mount: str) -> None:
    """Place the camera on the road, its vehicle around it and, at night, its head lights."""
    rng, course, ranges = scene.rng, road.course, MOUNTS[mount]
    lens, across = sample_lens(scene, TOWN_LENSES if road.name == "town" else LENSES), road.camera
    up, tall = degrees(atan(lens.half_up)), scene.between(ranges[rng.choice(("low", "high"))])
    pitch = scene.between(ranges["pitch"]) * up
    if mount != "truck" and scene.chance(0.15):
        pitch = rng.uniform(0.4, 0.9) * up
    yaw = _sample_yaw(scene, road)
    data: Any = bpy.data.cameras.new("camera")
    data.sensor_fit, data.clip_start, data.clip_end = "VERTICAL", 0.05, 2000
    data.angle_y = 2 * atan(lens.half_up)
    kerb = road.walks[1 if across > 0 else -1][2] if abs(across) > course.half else 0.0
    position = course.position(START, across, tall + kerb)
    camera = scene.blender.camera = scene.add("camera", data, position)
    slope = (course.points[START + 2].z - course.points[START].z) / 3
    turn = (radians(90 - pitch) + atan(slope), radians(rng.gauss(0, ranges["roll"])))
    camera.rotation_euler = (*turn, radians(yaw))
    clear_way(scene, road, 1.5, 2.4)
    if scene.chance(ranges["body"]):
        put_body(scene, camera, lens, mount)
    if scene.night and not scene.chance(0.1):
        x, y, z = camera.location
        low = z - tall + min(tall - 0.1, rng.uniform(0.6, 0.9))
        ahead, lamps = (0.5, (0.0,)) if mount in RIDERS else (2.2, (-0.6, 0.6))
        put_head_lights(scene, (x, y + ahead, low), (atan(slope), radians(yaw) * 0.3), lamps)


def sample_across(scene: Scene, road: Road, mount: str) -> float:
    """Sample the camera's metres from the middle of the road; some are walkable it."""
    rng, half, hand = scene.rng, road.course.half, scene.hand
    _, high, _ = road.walks[hand]
    walkable = road.kind.edges.keys() & {"kerb", "flush"}
    if mount in ("robot", "bicycle") and walkable and scene.chance(0.35):
        return hand * rng.uniform(min(half + 0.6, high), min(high, half + 4))
    if mount == "bicycle" and road.name not in NARROW and half > 1.6:
        return hand * (half - rng.uniform(0.4, 1.3))
    if road.lane is not None and mount in FISHEYES:
        return road.lane
    if road.lane is not None:
        return road.lane + rng.uniform(-0.3, 0.3) * (4 if mount in RIDERS else 1)
    narrow = road.name in NARROW
    return (rng.uniform(-0.25, 0.25) if narrow else rng.uniform(-0.55, 0.6)) * half


def _sample_yaw(scene: Scene, road: Road) -> float:
    """Sample the camera's yaw in degrees to the left; larger where its vehicle turns off."""
    rng = scene.rng
    if road.lane is None:
        return rng.gauss(0, 5) if scene.chance(0.85) else rng.gauss(0, 18)
    if not road.is_open(START) and scene.chance(0.5):
        return rng.uniform(-65, 65)
    # towards the lanes beyond rather than to the kerb
    return rng.gauss(1.5 * scene.hand, 3) if scene.chance(0.92) else rng.gauss(0, 15)


def sample_lens(scene: Scene, lenses: tuple[tuple[int, int], ...] = LENSES) -> Lens:
    """Sample a lens, narrow to wide, and an aspect ratio; set how images are squeezed."""
    rng, ratio = scene.rng, WIDTH / HEIGHT
    squeeze = rng.choice(SHAPES) / ratio
    set_resolution(scene, squeeze)
    half_across = tan(radians(scene.between(rng.choice(lenses))))
    return Lens(half_across / (ratio * squeeze), half_across)


def set_resolution(scene: Scene, squeeze: float) -> None:
    """Set the images' size; squeeze: how much wider the camera's own images are."""
    render = scene.blender.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, squeeze), max(1.0, 1 / squeeze)


def axes_at(road: Road, index: int) -> Any:
    """Return the axes of the road at a point of its course: across, along, up."""
    first, second = road.course.points[index : index + 2]
    climb = atan((second.z - first.z) / SPACING)
    turn = Matrix.Rotation(-road.course.heading(index), 4, "Z")
    return Matrix.Translation(first) @ turn @ Matrix.Rotation(climb, 4, "X")


def clear_way(scene: Scene, road: Road, across: float, ahead: float) -> None:
    """Remove the objects that stand within some metres across and along of the camera."""
    bpy.context.view_layer.update()
    back = axes_at(road, scene.station).inverted()
    camera = back @ scene.blender.camera.matrix_world.translation
    for thing in list(scene.blender.objects):
        upright = tuple(thing.color) == (*COLOURS[VERTICAL], 1) or thing.hide_render
        if upright and thing.location.length and thing.type == "MESH":
            away = back @ thing.matrix_world.translation - camera
            if abs(away.x) < across and abs(away.y) < ahead and away.z < 1.5:
                bpy.data.objects.remove(thing)


def put_head_lights(
    scene: Scene, middle: Point, aim: Limits, lamps: tuple[float, ...] = (-0.6, 0.6)
) -> None:
    """Put low beams at offsets from a point, each a narrow strong beam over a wide weak one.

    They end below the horizon, reach far along the near kerb and leave the oncoming half dark.
    aim: radians up and to the left.
    """
    rng = scene.rng
    watts, aside, soft = rng.uniform(1500, 9000), rng.uniform(1, 9), rng.uniform(0.7, 1.0)
    far, near = rng.uniform(5, 9), rng.uniform(20, 36)  # degrees from upper to lower end
    cut, weaker = rng.uniform(0.2, 1.2), rng.uniform(0.12, 0.5)
    colour = (1, rng.uniform(0.8, 0.97), rng.uniform(0.6, 0.95))
    for side in lamps:
        for power, tall, flat in ((watts, far, 5.0), (watts * weaker, near, 3.5)):
            light: Any = bpy.data.lights.new("head light", "SPOT")
            light.energy, light.spot_size, light.spot_blend = power, radians(tall), soft
            light.color, light.shadow_soft_size = colour, 0.06
            thing = scene.add("head light", light, (middle[0] + side, middle[1], middle[2]))
            up = aim[0] + radians(90 - cut - tall / 2)
            thing.rotation_euler = (up, 0, aim[1] - scene.hand * radians(aside))
            thing.scale = (flat, 1, 1)
