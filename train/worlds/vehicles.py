"""Traffic: cars, vans, lorries, buses, motorbikes, rickshaws, driving, standing, close ahead."""

from typing import Any

from train.worlds.materials import drawn, lamp, plain
from train.worlds.roads import START, Road
from train.worlds.stage import VERTICAL, Material, Shape, Stage, box, extruded, moved, turned, wheel
from train.worlds.surroundings import person

PAINTS = [
    (0.5, 0.02, 0.02),
    (0.7, 0.7, 0.7),
    (0.015, 0.015, 0.015),
    (0.04, 0.08, 0.35),
    (0.25, 0.25, 0.26),
    (0.85, 0.85, 0.83),
    (0.35, 0.3, 0.2),
    (0.6, 0.4, 0.02),
]

Parts = list[tuple[Shape, Material]]


def build_traffic(stage: Stage, road: Road) -> None:
    """Vehicles on the road and at its edge."""
    at, half = stage.at, road.course.half
    makers = {
        "car": _car,
        "van": _van,
        "lorry": _lorry,
        "motorbike": _motorbike,
        "rickshaw": _rickshaw,
    }
    common = ["car"] * 7 + ["van"] * 2 + ["lorry"] * 2 + ["motorbike"]
    if road.kind == "bazaar":
        common = ["car"] * 3 + ["motorbike"] * 5 + ["rickshaw"] * 3 + ["lorry"]
    pool = [stage.mesh(makers[kind](stage), smooth=False) for kind in at.choices(common, k=4)]
    counts = {
        "track": [0, 0, 0, 1],
        "trail": [0, 0, 0, 1],
        "overgrown": [0, 0, 0, 1],
        "lane": [0, 0, 1],
        "yard": [2, 6, 12],
    }
    count = at.choice(counts.get(road.kind, [0, 1, 3, 6]))
    taken: list[tuple[int, float]] = []
    for number in range(count):
        near = number == 0 and stage.chance(0.3)
        index = (
            at.randint(START + 4, START + 8)
            if near
            else at.randint(START + 7, min(80, road.length + 5))
        )
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
    """Put a vehicle where none stands yet."""
    room = 1 if turn else 4
    if index > 120 or any(abs(index - i) < room and abs(across - a) < 2.2 for i, a in taken):
        return
    taken.append((index, across))
    away = 3.14 if across < 0 and stage.chance(0.6) else 0.0
    where = road.course.at(index, across, 0.04)
    turn = turn + away + stage.at.gauss(0, 0.06) - road.course.headings[index]
    stage.put(stage.at.choice(pool), VERTICAL, where, turn)


def _common(stage: Stage) -> tuple[Material, Material, Material, Material, Material]:
    """Paint, glass, rubber, tail lights, head lights."""
    lit = stage.night or stage.chance(0.2)
    paint = plain(stage, drawn(stage, PAINTS), stage.at.uniform(0.15, 0.5), vary=0.05)
    glass, rubber = (
        plain(stage, (0.02, 0.022, 0.025), 0.06, vary=0),
        plain(stage, (0.012, 0.012, 0.012), 0.9),
    )
    red = (
        lamp(stage, (1, 0.03, 0.01), 6 if stage.night else 3)
        if lit
        else plain(stage, (0.4, 0.01, 0.01), 0.3)
    )
    white = (
        lamp(stage, (1, 0.95, 0.8), 40 if stage.night else 4)
        if lit
        else plain(stage, (0.6, 0.6, 0.6), 0.2)
    )
    return paint, glass, rubber, red, white


def _wheels(rubber: Material, half: float, ends: tuple[float, ...], radius: float) -> Parts:
    return [
        (wheel(side * (half - 0.12), end, radius, 0.22), rubber) for side in (-1, 1) for end in ends
    ]


def _lights(
    width: float, back: float, front: float, up: float, red: Material, white: Material
) -> Parts:
    parts: Parts = []
    for side in (-1, 1):
        parts.append((box((side * width * 0.8, back - 0.02, up), (0.3, 0.06, 0.16)), red))
        parts.append((box((side * width * 0.75, front + 0.02, up - 0.1), (0.3, 0.06, 0.14)), white))
    return parts


def _car(stage: Stage, tall: float = 0.0) -> Parts:
    """A car 4 to 4.8 metres long: body, cabin of glass under a roof, lights, wheels."""
    at = stage.at
    paint, glass, rubber, red, white = _common(stage)
    a, half, up = at.uniform(1.95, 2.4), at.uniform(0.82, 0.95), at.uniform(1.35, 1.75) + tall
    belt, tail = at.uniform(0.85, 1.0) + tall / 2, at.choice([-a + 0.05, -a + 0.6])
    body = [
        (-a, 0.35),
        (-a, belt - 0.05),
        (-a + 0.2, belt),
        (a - 1.3, belt),
        (a - 0.15, belt - 0.22),
        (a, 0.6),
        (a, 0.3),
    ]
    cabin = [
        (tail, belt - 0.02),
        (tail + 0.35, up - 0.06),
        (0.25, up - 0.06),
        (a - 1.05, belt - 0.02),
    ]
    roof = [(tail + 0.32, up - 0.07), (tail + 0.45, up), (0.15, up), (0.3, up - 0.07)]
    parts: Parts = [
        (
            extruded(body, [half * 0.97, half, half, half, half * 0.95, half * 0.93, half * 0.93]),
            paint,
        ),
        (extruded(cabin, [half * 0.95, half * 0.76, half * 0.76, half * 0.95]), glass),
        (extruded(roof, [half * 0.77, half * 0.73, half * 0.73, half * 0.77]), paint),
        (box((0, -a - 0.01, 0.62), (0.5, 0.03, 0.13)), plain(stage, (0.75, 0.75, 0.7), 0.5)),
        (box((0, 0, 0.32), (half * 1.9, 2 * a, 0.16)), rubber),
    ]
    parts += _wheels(rubber, half, (-a + 0.75, a - 0.85), 0.32)
    return parts + _lights(half, -a, a, belt - 0.15, red, white)


def _van(stage: Stage) -> Parts:
    return _car(stage, stage.at.uniform(0.3, 0.7))


def _lorry(stage: Stage) -> Parts:
    """A lorry or a bus: a long box on wheels, a cabin before it."""
    at = stage.at
    paint, glass, rubber, red, white = _common(stage)
    long, tall, half = at.uniform(5, 11), at.uniform(2.6, 3.8), 1.22
    load = plain(stage, drawn(stage, PAINTS), 0.7, vary=0.25)
    parts: Parts = [
        (box((0, 0, 0.9 + tall / 2 - 0.45), (2 * half, long, tall - 0.5)), load),
        (box((0, long / 2 + 1.0, 1.6), (2 * half, 1.7, 2.2)), paint),
        (box((0, long / 2 + 1.87, 2.1), (2.1, 0.06, 0.8)), glass),
    ]
    if stage.chance(0.4):
        parts.append((box((0, -0.1, 2.2), (2 * half + 0.05, long - 0.3, 0.8)), glass))
    parts += _wheels(rubber, half, (-long / 2 + 1, -long / 2 + 2.1, long / 2 + 0.8), 0.5)
    return parts + _lights(half, -long / 2, long / 2 + 1.86, 0.95, red, white)


def _motorbike(stage: Stage) -> Parts:
    """A motorbike or scooter with one or two people on it."""
    paint, _, rubber, red, _ = _common(stage)
    parts: Parts = [(wheel(0, -0.6, 0.29, 0.12), rubber), (wheel(0, 0.65, 0.29, 0.12), rubber)]
    parts += [
        (box((0, 0, 0.62), (0.28, 1.1, 0.32)), paint),
        (box((0, 0.5, 0.98), (0.7, 0.06, 0.06)), rubber),
    ]
    parts.append((box((0, -0.72, 0.72), (0.16, 0.06, 0.1)), red))
    for seat in (-0.1, -0.5)[: stage.at.choice([1, 1, 2])]:
        parts += [(moved(shape, (0, seat, 0.1)), look) for shape, look in person(stage)]
    return parts


def _rickshaw(stage: Stage) -> Parts:
    """A three-wheeled taxi with a hood."""
    paint, glass, rubber, red, _ = _common(stage)
    hood = plain(
        stage, drawn(stage, [(0.02, 0.02, 0.02), (0.6, 0.4, 0.02), (0.03, 0.2, 0.05)]), 0.8
    )
    body = [(-1.2, 0.35), (-1.25, 1.05), (0.7, 1.0), (1.25, 0.75), (1.25, 0.35)]
    top = [(-1.25, 1.0), (-1.15, 1.65), (-0.9, 1.75), (0.5, 1.72), (0.8, 1.0)]
    parts: Parts = [
        (extruded(body, [0.62, 0.65, 0.65, 0.3, 0.3]), paint),
        (extruded(top, [0.62, 0.58, 0.55, 0.5, 0.55]), hood),
    ]
    parts += [
        (box((0, 0.72, 1.35), (0.95, 0.05, 0.55)), glass),
        (turned([(0.05, 0), (0.05, 0.1)], 5), rubber),
    ]
    parts += [*_wheels(rubber, 0.65, (-0.8,), 0.25), (wheel(0, 1.0, 0.25, 0.12), rubber)]
    return [
        *parts,
        (box((0.45, -1.27, 0.8), (0.15, 0.05, 0.12)), red),
        (box((-0.45, -1.27, 0.8), (0.15, 0.05, 0.12)), red),
    ]
