"""Vehicles: cars, vans, lorries, buses, motorbikes, rickshaws; driving, parked, close ahead."""

from typing import Any, NamedTuple

from train.worlds.course import START
from train.worlds.materials import drawn, lamp, palette, plain
from train.worlds.people import limb, rider
from train.worlds.roads import KINDS, Road
from train.worlds.stage import Material, Parts, Stage, box, extruded, moved, turned, wheel
from train.worlds.truth import VERTICAL

PAINTS = palette("50 2 2, 70 70 70, 1.5 1.5 1.5, 4 8 35, 25 25 26, 85 85 83, 35 30 20, 60 40 2")


def build_traffic(stage: Stage, road: Road) -> None:
    """Place vehicles on the road and at its edge."""
    at, half = stage.at, road.course.half
    common = [car] * 7 + [van] * 2 + [lorry] * 2 + [motorbike]
    if road.kind == "bazaar":
        common = [car] * 3 + [motorbike] * 5 + [_rickshaw] * 3 + [lorry]
    pool = [stage.mesh(make(stage)) for make in at.choices(common, k=4)]
    taken: list[tuple[int, float]] = []
    for number in range(at.choice(KINDS[road.kind].vehicles)):
        near = number == 0 and stage.chance(0.3)
        last = START + 8 if near else min(80, road.length + 5)
        index = at.randint(START + (4 if near else 7), last)
        across = at.choice((-0.5, 0.5, 0.45, -0.3)) * half * at.uniform(0.8, 1.2)
        _put(stage, road, pool, index, across, taken)
    if road.kind in ("street", "bazaar") and stage.chance(0.55):  # standing at the edge
        side = at.choice((-1, 1))
        for index in range(START + at.randint(3, 8), at.randint(30, 80), at.choice([4, 5, 9])):
            _put(stage, road, pool, index, side * (half - at.uniform(-0.2, 1.1)), taken)
    if road.kind == "yard":
        for side in (-1, 1):
            for index in range(START + 2, road.length - 1, 2):
                if stage.chance(0.45):
                    _put(stage, road, pool, index, side * (half - 2.4), taken, 1.57)


def _put(
    stage: Stage,
    road: Road,
    pool: list[Any],
    index: int,
    across: float,
    taken: list[tuple[int, float]],
    turn: float = 0.0,
) -> None:
    """Place a vehicle where there is none."""
    room = 1 if turn else 4
    if index > 120 or any(abs(index - i) < room and abs(across - a) < 2.2 for i, a in taken):
        return
    taken.append((index, across))
    away = 3.14 if across < 0 and stage.chance(0.6) else 0.0
    turn = turn + away + stage.at.gauss(0, 0.06) - road.course.headings[index]
    where = road.course.at(index, across, 0.04)
    stage.put(stage.at.choice(pool), VERTICAL, where, turn)


# --- what they are made of --------------------------------------------------------------


class Looks(NamedTuple):
    """The materials of a vehicle; tail and head are its lights."""

    paint: Material
    glass: Material
    rubber: Material
    tail: Material
    head: Material


def _looks(stage: Stage) -> Looks:
    lit = stage.night or stage.chance(0.2)
    return Looks(
        plain(stage, drawn(stage, PAINTS), stage.at.uniform(0.15, 0.5), vary=0.05),
        plain(stage, (0.02, 0.022, 0.025), 0.06, vary=0),
        plain(stage, (0.012, 0.012, 0.012), 0.9),
        lamp((1, 0.03, 0.01), 6 if stage.night else 3)
        if lit
        else plain(stage, (0.4, 0.01, 0.01), 0.3),
        lamp((1, 0.95, 0.8), 40 if stage.night else 4)
        if lit
        else plain(stage, (0.6, 0.6, 0.6), 0.2),
    )


def _wheels(rubber: Material, half: float, ends: tuple[float, ...], radius: float) -> Parts:
    places = [(side * (half - 0.12), end) for side in (-1, 1) for end in ends]
    return [(wheel(x, y, radius, 0.22), rubber) for x, y in places]


def _lights(looks: Looks, width: float, back: float, front: float, up: float) -> Parts:
    parts: Parts = []
    for side in (-width, width):
        parts.append((box((side * 0.8, back - 0.02, up), (0.3, 0.06, 0.16)), looks.tail))
        parts.append((box((side * 0.75, front + 0.02, up - 0.1), (0.3, 0.06, 0.14)), looks.head))
    return parts


def car(stage: Stage, tall: float = 0.0) -> Parts:
    """Return a car 4 to 4.8 metres long: body, cabin of glass under a roof, lights, wheels."""
    at, looks = stage.at, _looks(stage)
    a, half, up = at.uniform(1.95, 2.4), at.uniform(0.82, 0.95), at.uniform(1.35, 1.75) + tall
    belt, tail = at.uniform(0.85, 1.0) + tall / 2, at.choice([-a + 0.05, -a + 0.6])
    body = [(-a, 0.35), (-a, belt - 0.05), (-a + 0.2, belt), (a - 1.3, belt)]
    body += [(a - 0.15, belt - 0.22), (a, 0.6), (a, 0.3)]
    cabin = [(tail, belt - 0.02), (tail + 0.35, up - 0.06), (0.25, up - 0.06)]
    cabin.append((a - 1.05, belt - 0.02))
    roof = [(tail + 0.32, up - 0.07), (tail + 0.45, up), (0.15, up), (0.3, up - 0.07)]
    wide = [half * share for share in (0.97, 1, 1, 1, 0.95, 0.93, 0.93)]
    parts: Parts = [
        (extruded(body, wide), looks.paint),
        (extruded(cabin, [half * 0.95, half * 0.76, half * 0.76, half * 0.95]), looks.glass),
        (extruded(roof, [half * 0.77, half * 0.73, half * 0.73, half * 0.77]), looks.paint),
        (box((0, -a - 0.01, 0.62), (0.5, 0.03, 0.13)), plain(stage, (0.75, 0.75, 0.7), 0.5)),
        (box((0, 0, 0.27), (half * 1.9, 2 * a - 0.3, 0.22)), looks.rubber),
    ]
    parts += _wheels(looks.rubber, half, (-a + 0.75, a - 0.85), 0.32)
    return parts + _lights(looks, half, -a, a, belt - 0.15)


def van(stage: Stage) -> Parts:
    return car(stage, stage.at.uniform(0.3, 0.7))


def lorry(stage: Stage) -> Parts:
    """Return a lorry or a bus: a long box on wheels, a cabin in front of it."""
    at, looks = stage.at, _looks(stage)
    long, tall, half = at.uniform(5, 11), at.uniform(2.6, 3.8), 1.22
    load, end = plain(stage, drawn(stage, PAINTS), 0.7, vary=0.25), long / 2
    parts: Parts = [
        (box((0, 0, 0.9 + tall / 2 - 0.45), (2 * half, long, tall - 0.5)), load),
        (box((0, end + 1.0, 1.6), (2 * half, 1.7, 2.2)), looks.paint),
        (box((0, end + 1.87, 2.1), (2.1, 0.06, 0.8)), looks.glass),
    ]
    if stage.chance(0.4):
        parts.append((box((0, -0.1, 2.2), (2 * half + 0.05, long - 0.3, 0.8)), looks.glass))
    parts += _wheels(looks.rubber, half, (-end + 1, -end + 2.1, end + 0.8), 0.5)
    return parts + _lights(looks, half, -end, end + 1.86, 0.95)


def motorbike(stage: Stage) -> Parts:
    """Return a motorbike or scooter with one or two people on it."""
    looks = _looks(stage)
    parts: Parts = [(wheel(0, end, 0.29, 0.12), looks.rubber) for end in (-0.6, 0.65)]
    parts.append((box((0, 0, 0.62), (0.28, 1.1, 0.32)), looks.paint))
    parts.append((box((0, 0.5, 0.98), (0.7, 0.06, 0.06)), looks.rubber))
    parts.append((box((0, -0.72, 0.72), (0.16, 0.06, 0.1)), looks.tail))
    parts.append((limb((0, 0.42, 0.95), (0, 0.65, 0.29), 0.04, 0.04), looks.rubber))
    for seat in (0.1, -0.3)[: stage.at.choice([1, 1, 2])]:
        people = rider(stage, 0.82, (0.3, 0.45, 1.0), 0.25)
        parts += [(moved(shape, (0, seat, 0)), look) for shape, look in people]
    return parts


def _rickshaw(stage: Stage) -> Parts:
    """Return a three-wheeled taxi with a hood."""
    looks = _looks(stage)
    hood = plain(stage, drawn(stage, palette("2 2 2, 60 40 2, 3 20 5")), 0.8)
    body = [(-1.2, 0.35), (-1.25, 1.05), (0.7, 1.0), (1.25, 0.75), (1.25, 0.35)]
    top = [(-1.25, 1.0), (-1.15, 1.65), (-0.9, 1.75), (0.5, 1.72), (0.8, 1.0)]
    parts: Parts = [
        (extruded(body, [0.62, 0.65, 0.65, 0.3, 0.3]), looks.paint),
        (extruded(top, [0.62, 0.58, 0.55, 0.5, 0.55]), hood),
        (box((0, 0.72, 1.35), (0.95, 0.05, 0.55)), looks.glass),
        (turned([(0.05, 0), (0.05, 0.1)], 5), looks.rubber),
        *_wheels(looks.rubber, 0.65, (-0.8,), 0.25),
        (wheel(0, 1.0, 0.25, 0.12), looks.rubber),
    ]
    return parts + [(box((x, -1.27, 0.8), (0.15, 0.05, 0.12)), looks.tail) for x in (0.45, -0.45)]


def tram(stage: Stage) -> Parts:
    """Return the two or three cars of a tram."""
    at, half = stage.at, 1.2
    body = plain(stage, drawn(stage, palette("60 55 40, 60 3 3, 4 20 45, 65 65 65")), 0.3)
    glass, dark = (
        plain(stage, (0.02, 0.02, 0.025), 0.06, vary=0),
        plain(stage, (0.02, 0.02, 0.02), 0.9),
    )
    light = lamp((1, 0.95, 0.8), 20 if stage.night else 2)
    parts: Parts = []
    for number in range(at.choice([2, 3])):
        y = number * 10.5
        parts.append((box((0, y, 1.85), (2 * half, 10, 3.0)), body))
        parts.append((box((0, y, 2.3), (2 * half + 0.06, 9.4, 1.1)), glass))
        parts.append((box((0, y, 0.25), (2 * half - 0.3, 9, 0.4)), dark))
        parts.append((box((0, y, 1.9), (2 * half - 0.2, 10.6, 2.7)), dark))
    parts.append((box((0, -5.03, 2.3), (2 * half - 0.3, 0.06, 1.2)), glass))
    return parts + [(box((x, -5.04, 0.9), (0.3, 0.06, 0.2)), light) for x in (-0.8, 0.8)]
