"""The car or robot that carries the camera, as it sees it: bonnet, dashboard, pillar, plate."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from train.worlds.materials import drawn, palette, plain
from train.worlds.stage import Parts, Shape, Stage, box
from train.worlds.truth import EGO
from train.worlds.vehicles import PAINTS


class Lens(NamedTuple):
    """Tangents of half the vertical (half_up) and horizontal (half_across) field of view."""

    half_up: float
    half_across: float


def _attach(stage: Stage, camera: Any, parts: Parts, smooth: bool = False) -> None:
    stage.put(stage.mesh(parts, smooth), EGO).parent = camera


def _hull(lens: Lens, edge: float, deep: float, arch: float, swell: float, lean: float) -> Shape:
    """Return a surface below the camera whose far edge is at a fraction of the height from below.

    In the camera's axes (x right, y up, z back). edge: the fraction; deep: metres to the far edge;
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


def put_car(stage: Stage, camera: Any, lens: Lens, shares: Sequence[int] = (6, 3, 2)) -> None:
    """Add a bonnet that reflects the road, a dashboard, or a strip of one above the other.

    shares: weights by which each is sampled.
    """
    at = stage.at
    kind = at.choices(["bonnet", "dashboard", "both"], shares)[0]
    edge = at.uniform(0.03, 0.3) if kind == "bonnet" else at.uniform(0.08, 0.4)
    if kind != "dashboard":
        tone, rough = drawn(stage, PAINTS), at.choice([0.03, 0.12, 0.4])
        paint = plain(stage, tone, rough, at.choice([0.0, 0.4]), 0.03)
        deep, arch = at.uniform(1.1, 2.0), at.uniform(0.0, 0.35)
        hull = _hull(lens, edge, deep, arch, at.uniform(0, 0.12), at.uniform(0, 0.25))
        _attach(stage, camera, [(hull, paint)], smooth=True)
        if stage.chance(0.12):  # a star or a spray nozzle upon it
            up = -(1 - 2 * edge) * lens.half_up * 1.1
            _attach(stage, camera, [(box((0, up + 0.03, -1.1), (0.05, 0.1, 0.02)), paint)])
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
        _attach(stage, camera, parts)
    if stage.chance(0.15):
        _put_pillar(stage, camera, lens)


def _put_pillar(stage: Stage, camera: Any, lens: Lens) -> None:
    """Add a pillar of the windscreen at one side of the image, upright or leaning."""
    at = stage.at
    side = at.choice((-1, 1))
    out, wide = side * lens.half_across * at.uniform(0.35, 0.5), side * 0.6
    lean = side * at.uniform(0, 0.6) * lens.half_up
    points = [(out, -0.5, -0.5), (out + wide, -0.5, -0.5)]
    points += [(out + wide + lean, 0.5, -0.5), (out + lean, 0.5, -0.5)]
    look = plain(stage, drawn(stage, [*PAINTS, (0.02, 0.02, 0.02)]), at.uniform(0.1, 0.9))
    _attach(stage, camera, [((points, [(0, 1, 2, 3)]), look)])


def put_robot(stage: Stage, camera: Any, lens: Lens) -> None:
    """Add the front of a robot at the lower edge: a plate or a bar."""
    at = stage.at
    up = -(1 - 2 * at.uniform(0.02, 0.16)) * lens.half_up * 0.3
    look = plain(stage, drawn(stage, PAINTS), at.uniform(0.2, 0.8))
    wide = lens.half_across * at.uniform(0.2, 0.8)
    _attach(stage, camera, [(box((at.uniform(-0.1, 0.1), up - 0.1, -0.3), (wide, 0.2, 0.1)), look)])
