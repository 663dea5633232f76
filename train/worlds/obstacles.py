"""Small objects on and beside the road: bollards, posts, bins, cones, barriers, bicycles."""

from collections.abc import Callable
from math import exp, log

from train.worlds.course import SPACING, Course
from train.worlds.materials import drawn, palette, plain
from train.worlds.people import Cast, Figure, bicycle, limb, put_figure, tyre
from train.worlds.stage import Parts, Stage, box, moved, turned

GREYS = palette("3 3 3, 30 30 30, 60 58 50, 12 14 12")
SIGNAL = palette("60 12 2, 60 45 2, 55 3 2")

NEAREST, FARTHEST = 2.6, 65.0
"""Range in metres ahead in which people and obstacles are placed."""


def bollard(stage: Stage) -> Figure:
    """Return a post up to a metre tall, thin or stout."""
    at, wide = stage.at, stage.at.uniform(0.035, 0.11)
    tall, look = at.uniform(0.55, 1.1), plain(stage, drawn(stage, GREYS), 0.5)
    profile = [(wide, 0), (wide, tall), (wide * 0.6, tall + 0.04), (0.005, tall + 0.05)]
    parts: Parts = [(turned(profile, 8), look)]
    if stage.chance(0.5):
        band = turned([(wide * 1.05, tall * 0.8), (wide * 1.05, tall * 0.92)], 8)
        parts.append((band, plain(stage, at.choice([(0.7, 0.7, 0.68), (0.5, 0.03, 0.02)]), 0.4)))
    return Figure(parts, [])


def _post(stage: Stage) -> Figure:
    """Return a sign on a thin post."""
    at, metal = stage.at, plain(stage, (0.35, 0.35, 0.36), 0.4, metal=0.6)
    tall, wide = at.uniform(1.0, 3.0), at.uniform(0.022, 0.05)
    colours = palette("60 2 2, 2 8 50, 80 80 80, 70 50 2, 2 30 10")
    face = plain(stage, drawn(stage, colours), 0.5)
    disc = turned([(0.005, -0.01), (at.uniform(0.2, 0.4), -0.01), (0.005, 0.01)], 14)
    upright = ([(x, z, y + tall) for x, y, z in disc[0]], disc[1])
    plate = box((0, -0.03, tall), (at.uniform(0.3, 0.7), 0.02, at.uniform(0.3, 0.9)))
    return Figure(
        [(turned([(wide, 0), (wide, tall)], 6), metal), (at.choice((upright, plate)), face)], []
    )


def _bin(stage: Stage) -> Figure:
    """Return a bin on wheels, or a round one."""
    at, look = stage.at, plain(stage, drawn(stage, palette("2 8 3, 3 3 3, 20 20 20, 45 30 2")), 0.6)
    if stage.chance(0.35):
        wide = at.uniform(0.18, 0.3)
        return Figure([(turned([(wide * 0.85, 0.05), (wide, 0.9), (0.01, 0.95)], 10), look)], [])
    parts: Parts = [
        (box((0, 0, 0.58), (0.52, 0.58, 0.9)), look),
        (box((0, 0.02, 1.05), (0.56, 0.66, 0.06)), look),
    ]
    dark = plain(stage, (0.01, 0.01, 0.01), 0.9)
    wheels = [moved(tyre(-0.22, 0.11, 0.03, 12), (side, 0, 0)) for side in (-0.22, 0.22)]
    return Figure([*parts, *((wheel, dark) for wheel in wheels)], [])


def _cone(stage: Stage) -> Figure:
    """Return a traffic cone, or a thin post on a plate."""
    look, white = plain(stage, drawn(stage, SIGNAL), 0.6), plain(stage, (0.7, 0.7, 0.7), 0.5)
    foot = box((0, 0, 0.02), (0.36, 0.36, 0.04))
    if stage.chance(0.6):
        low = turned([(0.14, 0.04), (0.1, 0.3)], 9)
        band, top = turned([(0.1, 0.3), (0.075, 0.5)], 9), turned([(0.075, 0.5), (0.03, 0.75)], 9)
        return Figure([(foot, look), (low, look), (band, white), (top, look)], [])
    tall = stage.at.uniform(0.75, 1.1)
    post, band = (
        turned([(0.04, 0), (0.04, tall)], 7),
        turned([(0.043, tall - 0.3), (0.043, tall - 0.1)], 7),
    )
    return Figure([(foot, plain(stage, (0.02, 0.02, 0.02), 0.9)), (post, look), (band, white)], [])


def _barrier(stage: Stage) -> Figure:
    """Return striped boards on thin legs; the road is visible below them."""
    at, half = stage.at, stage.at.uniform(0.5, 1.2)
    red, white = plain(stage, (0.55, 0.03, 0.02), 0.5), plain(stage, (0.75, 0.75, 0.75), 0.5)
    parts: Parts = []
    for side in (-half * 0.8, half * 0.8):
        parts.append((limb((side, -0.3, 0), (side, 0, 1.0), 0.02, 0.02, 5), white))
        parts.append((limb((side, 0.3, 0), (side, 0, 1.0), 0.02, 0.02, 5), white))
    for up in (0.92, 0.5)[: at.choice((1, 2))]:
        for k in range(8):
            middle = (-half + (k + 0.5) * half / 4, 0, up)
            parts.append((box(middle, (half / 4, 0.03, 0.2)), (red, white)[k % 2]))
    return Figure(parts, [])


THINGS: dict[Callable[[Stage], Figure], float] = {
    bollard: 4,
    _post: 3,
    _bin: 3,
    _cone: 3,
    _barrier: 1,
    bicycle: 2,
}
"""Kinds of obstacles, with their weights."""


def sample_ahead(stage: Stage) -> float:
    """Sample a distance ahead in metres, log-uniform; with a wide lens also behind."""
    metres = exp(stage.at.uniform(log(NEAREST), log(FARTHEST)))
    return -metres if stage.around and metres < 20 and stage.chance(0.4) else metres


def put_people(
    stage: Stage, course: Course, beside: tuple[float, float], up: float, count: int
) -> None:
    """Place people on the road and beside it, facing along or across it.

    beside: metres from the middle to the near and the far end of the pavement; up: its height.
    """
    if not count:
        return
    at, cast = stage.at, Cast(stage, min(count, 6))
    for _ in range(count):
        index, half = stage.station + sample_ahead(stage) / SPACING, course.half
        across, height = at.choice((-1, 1)) * at.uniform(*beside), up
        turn = at.choice((0, 3.14)) + at.gauss(0, 0.3)
        if stage.chance(0.45):  # on the road: along its edges, or across it
            height = 0.03
            if stage.chance(0.5):
                across = at.choice((-1, 1)) * (half - at.uniform(0.1, 1.2))
            else:
                across, turn = at.uniform(-half, half), at.choice((1.57, -1.57)) + at.gauss(0, 0.4)
        cast.put(course.between(index, across, height), turn - course.heading(index))


def put_obstacles(stage: Stage, course: Course, up: float, count: int) -> None:
    """Place small objects at the edges of the road, behind its kerbs and on it; cones in a row."""
    if not count:
        return
    at, half = stage.at, course.half
    pool = []
    for maker in at.choices(list(THINGS), list(THINGS.values()), k=min(count, 4)):
        parts, veil = maker(stage)
        pool.append((stage.mesh(parts), stage.mesh(veil) if veil else None))

    def put(index: float, across: float, turn: float) -> None:
        where = course.between(index, across, up if abs(across) > half else 0.03)
        mesh, veil = at.choice(pool)
        put_figure(stage, mesh, veil, where, turn - course.heading(index))

    for _ in range(count):
        across = at.choice((-1, 1)) * (half + at.gauss(0, 0.5))
        if stage.chance(0.2):
            across = at.uniform(-0.8, 0.8) * half
        put(stage.station + sample_ahead(stage) / SPACING, across, at.uniform(0, 6.28))
    if stage.chance(0.15):
        pool = pool[:1]
        first, line = at.uniform(3, 15), at.uniform(-0.6, 0.9) * half
        for k in range(at.randint(4, 12)):
            put(stage.station + first + k * 1.3, line + 0.1 * k, 0.0)
