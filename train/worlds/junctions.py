"""Junctions of a town's streets: side streets with their pavements and houses."""

from collections.abc import Sequence

from train.worlds.course import START
from train.worlds.materials import drawn, facade
from train.worlds.roads import Road
from train.worlds.stage import Material, Stage, box
from train.worlds.surroundings import WALLS
from train.worlds.truth import HORIZONTAL, ROAD, VERTICAL

REACH = 70
"""Length of a side street in metres."""


def sample_junctions(stage: Stage) -> list[tuple[int, int]]:
    """Sample no junction, one ahead or one at the camera; return points of the course."""
    at = stage.at
    if stage.chance(0.55):
        return []
    first = START - at.randint(1, 3) if stage.chance(0.15) else at.randint(START + 4, START + 30)
    return [(first, first + at.randint(4, 8))]


def build_side_street(
    stage: Stage,
    road: Road,
    gap: tuple[int, int],
    ends: Sequence[float],
    kerb: float,
    looks: tuple[Material, Material],
) -> None:
    """Build a street to the left, the right or both: carriageway, pavements, houses."""
    (low, high), (surface, walk), at = gap, looks, stage.at
    opened = at.choices([(-stage.hand,), (stage.hand,), (-1, 1)], (4, 2, 4))[0]
    for side in (-1, 1):
        edge, half = ends[side > 0], road.course.half
        if side not in opened:
            _build_slab(stage, road, gap, (side * half, side * edge), kerb + 0.005, walk)
            continue
        _build_slab(stage, road, gap, (side * half * 0.9, side * REACH), 0.028, surface, ROAD)
        wide = at.uniform(1.0, 1.9)
        for span in ((low + 0.02 - wide, low + 0.02), (high - 0.02, high - 0.02 + wide)):
            across = (side * (edge - 0.05), side * REACH)
            _build_slab(stage, road, span, across, kerb + 0.014, walk)
        for index in (low - 4, high + 4):  # houses at the corners, and where the street ends
            build_block(stage, road, index, side * (edge + 24), (46.0, 6.5))
        build_block(stage, road, (low + high) // 2, side * (REACH + 4), (8.0, 40.0))


def _build_slab(
    stage: Stage,
    road: Road,
    span: tuple[float, float],
    across: tuple[float, float],
    up: float,
    look: Material,
    truth: int = HORIZONTAL,
) -> None:
    """Build a slab between two points of the course and two offsets across it, up to a height."""
    points = [
        road.course.between(max(index, 0.0), out, height)
        for height in (up, up - 0.25)
        for index in span
        for out in across
    ]
    sides = [(0, 1, 3, 2), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    mesh = stage.mesh([((points, sides), look)])
    mesh.uv_layers.new(name="UV")
    stage.put(mesh, truth)


def build_block(
    stage: Stage, road: Road, index: int, across: float, size: tuple[float, float]
) -> None:
    """Build a house of given metres across and along the main road."""
    tall = stage.at.uniform(5, 20)
    wall = facade(stage, drawn(stage, WALLS))
    mesh = stage.mesh([(box((0, 0, tall / 2 - 2), (*size, tall + 4)), wall)])
    where, turn = road.course.between(index, across), -road.course.heading(index)
    stage.put(mesh, VERTICAL, where, turn)
