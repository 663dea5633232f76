"""The course of a road, and cross-sections swept along it, which follow its hills.

A cross-section is given as (across, up) in metres from the middle of the road.
"""

from collections.abc import Sequence
from math import cos, sin
from typing import NamedTuple

from mathutils import Vector, noise

from train.worlds.stage import Material, Stage

SPACING = 1.5
"""Metres between the course's points."""

START = 10
"""Index of the point at which the camera stands."""

FAR = 85
"""Index from which on (112 metres ahead) the road is void: human labels end somewhere there."""

BEHIND = 22
"""Index ahead of ``START`` at which a camera stands that looks backwards."""

END = 130
"""Number of points of a course."""

Section = Sequence[tuple[float, float]]


class Course(NamedTuple):
    """The centre line of a road: points (x, y, z), headings in radians, half width in metres."""

    points: list[Vector]
    headings: list[float]
    half: float

    def at(self, index: int, across: float, up: float = 0.0) -> tuple[float, float, float]:
        """Return the position of a point beside the course."""
        heading, middle = self.headings[index], self.points[index]
        return (middle.x + across * cos(heading), middle.y - across * sin(heading), middle.z + up)

    def between(self, index: float, across: float, up: float = 0.0) -> tuple[float, float, float]:
        """Return the position between two points of the course."""
        first = max(0, min(int(index), END - 2))
        ends = [Vector(self.at(first + step, across, up)) for step in (0, 1)]
        x, y, z = ends[0].lerp(ends[1], min(max(index - first, 0.0), 1.0))
        return x, y, z

    def heading(self, index: float) -> float:
        """Return the heading at the nearest point of the course, in radians."""
        return self.headings[max(0, min(round(index), END - 1))]


def swept(
    stage: Stage,
    course: Course,
    section: Section,
    material: Material,
    truth: int,
    ragged: float = 0.0,
    span: tuple[int, int] = (0, END),
    bumps: float = 0.0,
) -> None:
    """Sweep a cross-section along a part of the course.

    ragged: amplitude in metres of its ends' wandering; bumps: of its height.
    """
    points, uvs = [], []
    count, seed = len(section), stage.at.uniform(0, 1000)
    for index in range(span[0], min(span[1], END)):
        for k, (across, up) in enumerate(section):
            if ragged and k in (0, count - 1):
                spot = Vector((index * 0.4, seed + 9 * k, 0))
                across += ragged * (1.6 * noise.noise(spot) + stage.at.uniform(-0.4, 0.4))
            if bumps:
                up += bumps * noise.noise(Vector((index * 0.8, across * 1.3, seed)))
            points.append(course.at(index, across, up))
            uvs.append((across, index * SPACING))
    corners = [k for k in range(len(points) - count) if (k + 1) % count]
    faces = [(a, a + 1, a + count + 1, a + count) for a in corners]
    if faces:
        mesh = stage.mesh([((points, faces), material)])
        layer = mesh.uv_layers.new(name="UV")
        layer.data.foreach_set("uv", [value for face in faces for k in face for value in uvs[k]])
        stage.put(mesh, truth)
