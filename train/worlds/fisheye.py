"""Surround cameras: fisheyes at a car's front, rear and mirrors, tilted down, its body in view."""

from math import radians
from typing import Any, NamedTuple

from train.worlds.blender import Matrix, Vector, bpy
from train.worlds.camera import axes_at, clear_way, put_head_lights, set_resolution
from train.worlds.figures import build_thing, sample_material
from train.worlds.ground import build_block
from train.worlds.lens import SENSOR, Fisheye, angle_polynomial, sample_fisheye
from train.worlds.road import Road
from train.worlds.scene import HEIGHT, WIDTH, Parts, Point, Scene
from train.worlds.shapes import box, stretch, translate
from train.worlds.truth import EGO


class Pose(NamedTuple):
    """Pose of a camera on the car: metres across, along, up; degrees to the left and down."""

    position: Point
    yaw: float
    pitch: float


def build_fisheye(scene: Scene, road: Road, side: str) -> None:
    """Place a fisheye at a side of a car (or a robot) on the road, and the car around it."""
    rng = scene.rng
    scene.lens = sample_fisheye(rng, WIDTH, HEIGHT)
    turn = rng.gauss(0, 0.05) if scene.chance(0.8) else rng.uniform(-0.8, 0.8)
    axes = axes_at(road, scene.station) @ Matrix.Translation((road.camera, 0, 0.035))
    axes @= Matrix.Rotation(turn, 4, "Z")
    body, _ = build_thing(scene, rng.choice(("car", "estate", "van")))
    body = [] if side == "front" and scene.chance(0.3) else body
    corners = [point for (points, _), _ in body for point in points] or [(0.3, 0.0, 0.0)]
    half = max(abs(x) for x, _, _ in corners)
    end, tail = max(y for _, y, _ in corners), min(y for _, y, _ in corners)
    pose = _sample_pose(scene, side, half, end, tail)
    _place_camera(scene, axes, pose)
    clear_way(scene, road, 2.4, 4.0)
    if body:
        for parts, smooth in ((body, False), (_trim(scene, side, pose, half), True)):
            scene.put(scene.mesh(parts, smooth), EGO).matrix_world = axes
    if scene.night and not scene.chance(0.1):
        front = axes @ Vector((0, end + 0.1, 0.65))
        put_head_lights(scene, tuple(front), (axes.to_euler().x, axes.to_euler().z))
        white = scene.chance(0.6)  # reversing lights
        for x in (-0.7 * half, 0.7 * half) if side == "rear" else ():
            for colour, watts in (((1, 0.03, 0.01), 3.0), ((1, 0.95, 0.85), 25.0 * white)):
                scene.add_lamp(axes @ Vector((x, tail - 0.12, 0.8)), colour, watts)
    if "kerb" in road.kind.edges:  # what the street comes from, seen by cameras that look behind
        build_block(scene, road, 0, 0.0, (70.0, 8.0))


def _sample_pose(scene: Scene, side: str, half: float, end: float, tail: float) -> Pose:
    """Sample the pose of a camera on a car with this half width, front end and tail."""
    rng = scene.rng
    pitch = rng.uniform(0, 25) if scene.chance(0.5) else rng.uniform(15, 60)
    if side in ("left", "right"):
        sign = -1 if side == "left" else 1
        out, along, up = rng.uniform(0.06, 0.2), rng.uniform(0.3, 0.9), rng.uniform(0.85, 1.2)
        yaw = 90 + (rng.gauss(0, 6) if scene.chance(0.6) else rng.uniform(-40, 40))
        return Pose((sign * (half + out), along, up), -sign * yaw, rng.uniform(28, 75))
    if side == "rear":
        position = (rng.uniform(-0.2, 0.2), tail - rng.uniform(0.02, 0.06), rng.uniform(0.65, 1.15))
        return Pose(position, 180 + rng.gauss(0, 2), max(pitch, rng.uniform(5, 40)))
    position = (rng.uniform(-0.15, 0.15), end + rng.uniform(0.02, 0.06), rng.uniform(0.35, 0.9))
    return Pose(position, rng.gauss(0, 2), pitch)


def _trim(scene: Scene, side: str, pose: Pose, half: float) -> Parts:
    """Return the flanks and the mirror that holds a camera, or the bumper below it."""
    rng, (x, y, z) = scene.rng, pose.position
    if side in ("left", "right"):
        out = 1 if x > 0 else -1
        shell = (x + out * rng.uniform(-0.1, 0.08), y, z + rng.uniform(0.07, 0.12))
        size = (rng.uniform(0.2, 0.32), rng.uniform(0.12, 0.2), rng.uniform(0.06, 0.14))
        parts, wide = build_thing(scene, "flank")[0], half / 0.88 * rng.uniform(0.97, 1.02)
        parts = [(stretch(shape, (wide, 1, 1)), material) for shape, material in parts]
        return [*parts, (box(shell, size), sample_material(scene, "shade"))]
    parts, _ = build_thing(scene, side)
    ends = [point[1] for (points, _), _ in parts for point in points]
    reach = rng.uniform(0.0, 0.2)  # of the bumper beyond the camera
    ahead = y + reach - max(ends) if y > 0 else y - reach - min(ends)
    up = z - rng.uniform(0.1, 0.3) - 0.72
    return [(translate(shape, (0, ahead, min(up, 0.15))), material) for shape, material in parts]


def _place_camera(scene: Scene, axes: Any, pose: Pose) -> None:
    """Place the camera and set its lens."""
    lens: Fisheye = scene.lens
    data: Any = bpy.data.cameras.new("camera")
    data.type, data.panorama_type = "PANO", "FISHEYE_LENS_POLYNOMIAL"
    data.sensor_fit, data.clip_start, data.clip_end = "HORIZONTAL", 0.01, 2000
    data.sensor_width = SENSOR
    for k, weight in enumerate(angle_polynomial(lens)):
        setattr(data, f"fisheye_polynomial_k{k}", -weight)  # Blender counts them so
    data.fisheye_fov = radians(lens.view)
    camera = scene.blender.camera = scene.add("camera", data, (0, 0, 0))
    roll = scene.rng.gauss(0, 1.5)
    spin = Matrix.Rotation(radians(pose.yaw), 4, "Z")
    spin = spin @ Matrix.Rotation(radians(90 - pose.pitch), 4, "X")
    spin = spin @ Matrix.Rotation(radians(roll), 4, "Z")
    camera.matrix_world = axes @ Matrix.Translation(pose.position) @ spin
    set_resolution(scene, lens.shape / (WIDTH / HEIGHT))
    angles = {"yaw": pose.yaw, "pitch": pose.pitch, "roll": roll}
    scene.mount = {"height": pose.position[2], **angles}
