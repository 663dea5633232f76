"""Objects and traffic of a town: houses, trees, lamps, people, obstacles, vehicles."""

from train.worlds.course import END, SPACING, START
from train.worlds.materials import drawn, facade, ground, lamp, palette, plain
from train.worlds.obstacles import bollard, put_obstacles, put_people
from train.worlds.roads import SNOW, Road, swept_between
from train.worlds.stage import Material, Parts, Stage, box
from train.worlds.surroundings import (
    WALLS,
    build_bridge,
    build_hills,
    build_posts,
    build_trees,
    crown,
    gable,
)
from train.worlds.towns import Street
from train.worlds.truth import VERTICAL
from train.worlds.vehicles import car, lorry, motorbike, tram, van


def furnish_town(stage: Stage, road: Road, street: Street, crowd: bool) -> None:
    """Build terraces, houses or a park on each side, trees, lamps, people, traffic."""
    at = stage.at
    tones = {"snow": SNOW, "dry": palette("20 15 7, 28 20 12")}
    mine = tones.get(road.season, palette("6 12 3, 10 15 5, 4 9 3"))
    leaf = ground(stage, drawn(stage, mine, 0.4), drawn(stage, mine, 0.4), at.uniform(1, 5), 0.3, 0)
    for side in (-1, 1):
        kind = at.choices(["terrace", "houses", "park"], [6, 3, 1])[0]
        if kind == "park":
            _build_hedge(stage, road, side, street.walks[side][1], leaf)
        else:
            _build_terrace(stage, road, side, street.walks[side][1], kind == "houses")
    beside = (min(low for low, _ in street.walks.values()), road.land)
    verge = road._replace(
        land=beside[0], land_rises={side: [(0.0, 0.2), (90.0, 0.2)] for side in (-1, 1)}
    )
    build_trees(stage, verge, leaf, at.choice([0, 0, 6, 14]))
    # half of a street is often unlit: its lamps stand on the camera's side alone
    side = stage.hand if stage.chance(0.7) else None
    build_posts(stage, verge, at.choice([0, 5, 10]), side)
    _build_bollards(stage, road, street)
    put_people(
        stage,
        road.course,
        beside,
        street.kerb,
        at.randint(5, 24) if crowd else at.choice([0, 3, 8, 16]),
    )
    put_obstacles(
        stage, road.course, street.kerb, at.randint(2, 14) if crowd else at.choice([0, 0, 3])
    )
    if stage.chance(0.08):
        build_bridge(stage, road)
    if stage.chance(0.5):
        build_hills(stage)
    _put_traffic(stage, road, street)


def _build_terrace(stage: Stage, road: Road, side: int, edge: float, apart: bool) -> None:
    """Build fronts behind the pavement, wall to wall, or houses apart behind hedges and walls."""
    at, index = stage.at, START - 8
    roof = plain(stage, drawn(stage, WALLS), 0.9, vary=0.4)
    back = at.choice([2.0, 5.0]) if apart else at.choice([0.0, 0.0, 0.3, 1.0])
    even = at.uniform(5, 20)
    while index < 118:
        long, deep = at.uniform(6, 20), at.uniform(8, 12)
        tall = even * at.uniform(0.75, 1.25) if not apart else at.uniform(3, 9)
        middle = index + int(long / SPACING / 2)
        index += int(long / SPACING) + (
            at.choice([1, 3, 6]) if apart else at.choice([0, 0, 0, 0, 3])
        )
        if not (road.open(middle - 2) and road.open(middle + 2)) or middle >= END:
            continue
        wall = facade(stage, drawn(stage, WALLS))
        parts: Parts = [(box((0, 0, tall / 2 - 2), (deep, long, tall + 4)), wall)]
        face = -side * (deep / 2 + 0.02)
        if stage.chance(0.35) and not apart:  # a shop: its window, lit at night, and its awning
            light = at.uniform(0.4, 4) if stage.night else at.uniform(0, 0.2)
            shop = (
                lamp((1, 0.85, 0.65), light)
                if light > 0.1
                else plain(stage, (0.03, 0.03, 0.04), 0.1)
            )
            parts.append((box((face, 0, 1.5), (0.06, long * 0.8, 2.2)), shop))
            cloth = plain(stage, [at.uniform(0.05, 0.8) for _ in range(3)], 0.7)
            out = at.uniform(0.1, 1.2)
            parts.append((box((face - side * out / 2, 0, 2.8), (out, long * 0.85, 0.4)), cloth))
        if stage.chance(0.5):
            shape = gable(deep / 2 + 0.3, long / 2 + 0.1, tall, at.uniform(1, 3.5))
            parts.append((shape, roof))
        where = road.course.at(middle, side * (edge + back + deep / 2))
        stage.put(stage.mesh(parts), VERTICAL, where, -road.course.headings[middle])
    if apart:
        tall, wide = at.uniform(0.4, 1.9), at.uniform(0.15, 0.8)
        look = ground(stage, drawn(stage, WALLS), drawn(stage, WALLS), at.uniform(1, 8), 0.5, 0.9)
        a, b = side * (edge + 0.05), side * (edge + 0.05 + wide)
        section = [(a, -0.1), (a, tall), (b, tall), (b, -0.1)]
        swept_between(stage, road, section, look, VERTICAL)


def _build_hedge(stage: Stage, road: Road, side: int, edge: float, leaf: Material) -> None:
    """Plant a park's edge: bushes in a row, or lawn alone."""
    at = stage.at
    if stage.chance(0.4):
        return
    mesh = stage.mesh([(crown(stage, 700, 0.2), leaf)])
    for index in range(START, 100):
        if road.open(index):
            size = at.uniform(0.6, 1.3)
            where = road.course.at(index, side * (edge + size + 0.2), size * 0.5)
            stage.put(mesh, VERTICAL, where, at.uniform(0, 6), (1.3, 1.3, size))


def _build_bollards(stage: Stage, road: Road, street: Street) -> None:
    """Add a row of bollards along a kerb."""
    at = stage.at
    if stage.chance(0.65):
        return
    mesh = stage.mesh(bollard(stage).parts)
    side, spacing = at.choice((-1, 1)), at.choice([1, 2, 3])
    for index in range(START + 1, 70, spacing):
        if road.open(index):
            across = side * (street.walks[side][0] + 0.35)
            stage.put(mesh, VERTICAL, road.course.at(index, across, street.kerb))


def _put_traffic(stage: Stage, road: Road, street: Street) -> None:
    """Add none, a few or a queue of vehicles to each lane; trams; rows of parked cars."""
    at, course = stage.at, road.course
    small = [
        stage.mesh(make(stage)) for make in at.choices([car] * 6 + [van] * 2 + [motorbike], k=5)
    ]
    large = stage.mesh(lorry(stage))
    own = road.lane or 0.0

    def stand(mesh: object, index: int, across: float, turn: float, up: float = 0.04) -> None:
        if index < 118:
            turn += at.gauss(0, 0.04) - course.headings[index]
            stage.put(mesh, VERTICAL, course.at(index, across, up), turn)

    for across, direction in street.lanes:
        gap = at.choice([0, 0, 30, 15, 6] if direction > 0 else [0, 0, 0, 40, 25, 12])
        index = START + (at.randint(6, 18) if abs(across - own) < 1 else at.randint(-2, 12))
        while gap and index < 100:
            big = stage.chance(0.1)
            stand(
                large if big else at.choice(small), index + 3 * big, across, 3.14 * (direction < 0)
            )
            index += 4 + 7 * big + int(at.expovariate(1 / gap))
    if street.tram is not None and stage.chance(0.35):
        index = START + at.randint(9, 40)
        stand(stage.mesh(tram(stage)), index, street.tram, 0.0)
    for side, across in street.parking.items():
        if not across or (own * side > 0 and abs(own - across) < 1.9):
            continue
        full, turn = at.uniform(0.4, 0.95), 3.14 * stage.chance(0.4)
        square = abs(across) - course.half > 2  # bays across the street
        for index in range(START - 2, 95, 2 if square else 4):
            if road.open(index) and stage.chance(full):
                up = street.kerb if abs(across) - course.half in (1.1, 0.3) else 0.04
                stand(at.choice(small), index, across, turn + 1.57 * square, up)
