"""Where people, small things and vehicles are: on the road and beside it, in lanes, parked."""

from math import exp, log

from train.worlds.figures import build_thing
from train.worlds.plans import Weights
from train.worlds.road import SPACING, START, Road
from train.worlds.scene import Point, Scene
from train.worlds.tables import read_column
from train.worlds.truth import VERTICAL, VOID

NEAREST, FARTHEST = 2.6, 65.0
"""Range in metres ahead in which people and obstacles are placed."""

WEIGHTS: dict[str, Weights] = read_column("weights", "weights")


class Cast:
    """The things of a world: a few meshes that are placed any number of times."""

    def __init__(self, scene: Scene, weights: Weights, count: int) -> None:
        self.scene, self.meshes = scene, []
        self.names = scene.rng.choices(list(weights), list(weights.values()), k=count)
        for name in self.names:
            self.add(name)

    def add(self, name: str) -> None:
        """Make the mesh of a further thing."""
        parts, veil = build_thing(self.scene, name)
        self.meshes.append((self.scene.mesh(parts), self.scene.mesh(veil) if veil else None))

    def put(self, position: Point, turn: float, number: int | None = None) -> None:
        """Place a thing, or the one of a number, and its veil, which only the truth shows."""
        count = len(self.meshes)
        mesh, veil = self.meshes[self.scene.rng.randrange(count) if number is None else number]
        self.scene.put(mesh, VERTICAL, position, turn)
        if veil:
            self.scene.put(veil, VOID, position, turn).hide_render = True


def populate(scene: Scene, road: Road, crowd: bool) -> None:
    """Place people and obstacles on the road and beside it, rows of bollards, vehicles."""
    rng, people = scene.rng, road.kind.people
    _put_people(scene, road, rng.randint(5, 24) if crowd else rng.choice(people))
    things = rng.choice((0, 2, 5)) if max(people) else 0
    _put_obstacles(scene, road, rng.randint(2, 14) if crowd else things)
    flush = "flush" in road.kind.edges
    if (flush or "kerb" in road.kind.edges) and scene.chance(0.6 if flush else 0.35):
        cast = Cast(scene, WEIGHTS["posts"], 1)
        side, spacing = rng.choice((-1, 1)), rng.choice([1, 2, 3])
        for index in filter(road.is_open, range(scene.station + 1, 70, spacing)):
            across, up = side * (road.walks[side][0] + 0.35), road.walks[side][2]
            cast.put(road.course.position(index, across, up - 0.02), 0.0)
    _put_traffic(scene, road)


def _sample_ahead(scene: Scene) -> float:
    """Sample a point of the course, at a log-uniform distance ahead; with a wide lens behind."""
    metres = exp(scene.rng.uniform(log(NEAREST), log(FARTHEST)))
    back = scene.looks_back and metres < 20 and scene.chance(0.4)
    return scene.station + (-metres if back else metres) / SPACING


def _put_people(scene: Scene, road: Road, count: int) -> None:
    """Place people, facing along or across the road."""
    rng, half, cast = scene.rng, road.course.half, Cast(scene, WEIGHTS["people"], min(count, 6))
    for _ in range(count):
        index, side = _sample_ahead(scene), rng.choice((-1, 1))
        low, high, up = road.walks[side]
        across, turn = side * rng.uniform(low, high), rng.choice((0, 3.14)) + rng.gauss(0, 0.3)
        if scene.chance(0.45):  # on the road: along its edges, or across it
            up = 0.03
            if scene.chance(0.5):
                across = side * (half - rng.uniform(0.1, 1.2))
            else:
                across, turn = rng.uniform(-half, half), side * 1.57 + rng.gauss(0, 0.4)
        cast.put(road.course.position(index, across, up), turn - road.course.heading(index))


def _put_obstacles(scene: Scene, road: Road, count: int) -> None:
    """Place small things at the edges of the road, behind its kerbs and on it; cones in a row."""
    rng, course, half = scene.rng, road.course, road.course.half
    cast, spots = Cast(scene, WEIGHTS["obstacles"], min(count, 3) + 1), []
    for _ in range(count):
        across = rng.choice((-1, 1)) * (half + rng.gauss(0, 0.5))
        if scene.chance(0.2):
            across = rng.uniform(-0.8, 0.8) * half
        spots.append((_sample_ahead(scene), across, rng.uniform(0, 6.28)))
    if scene.chance(0.15):
        first, line = scene.station + rng.uniform(2, 10), rng.uniform(-0.6, 0.9) * half
        spots += [(first + k * 0.9, line + 0.1 * k, 0.0) for k in range(rng.randint(4, 12))]
    for index, across, turn in spots:
        up = road.walks[1 if across > 0 else -1][2] if abs(across) > half else 0.03
        cast.put(course.position(index, across, up - 0.01), turn - course.heading(index))


def _put_traffic(scene: Scene, road: Road) -> None:
    """Add none, a few or a queue of vehicles to each lane; trams; rows of parked cars."""
    rng, course = scene.rng, road.course
    cast = Cast(scene, WEIGHTS.get(f"vehicles {road.name}", WEIGHTS["vehicles"]), 5)
    small = [k for k, name in enumerate(cast.names) if name != "lorry"] or [0]

    def stand(index: int, across: float, turn: float, number: int, up: float = 0.04) -> None:
        if index < min(118, road.length - 1):
            turn += rng.gauss(0, 0.04) - course.headings[index]
            cast.put(course.position(index, across, up), turn, number)

    for across, direction in road.lanes:
        gap, in_lane = rng.choice(road.kind.gaps), abs(across - road.camera) < 2
        first = rng.randint(5, 18) if in_lane else rng.randint(-2, 12)
        index = (scene.station if in_lane else START) + first
        while gap and index < 100:
            number = rng.randrange(len(cast.names))
            room = 5 * (cast.names[number] == "lorry")
            stand(index + room, across + rng.gauss(0, 0.2), 3.14 * (direction < 0), number)
            index += 4 + 2 * room + int(rng.expovariate(1 / gap))
    if road.tram is not None and scene.chance(0.35):
        cast.add("tram")
        stand(START + rng.randint(9, 40), road.tram, 0.0, -1)
    for across, up in road.parking.values():
        if abs(road.camera - across) < 1.9:
            continue
        full, turn = rng.uniform(0.4, 0.95), 3.14 * scene.chance(0.4)
        square = road.name == "yard" or abs(across) - course.half > 2  # bays across the street
        for index in range(START - 2, min(95, road.length - 1), 2 if square else 4):
            if road.is_open(index) and scene.chance(full):
                stand(index, across, turn + 1.57 * square, rng.choice(small), up)
