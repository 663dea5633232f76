"""Paint on the carriageway: lines, zebra crossings, bays, patches."""

from itertools import pairwise

from train.worlds.materials import pave, plain, sample_grey, sample_paving
from train.worlds.road import FAR, START, Road, Span, sweep
from train.worlds.scene import Material, Scene
from train.worlds.truth import ROAD


def mark_road(scene: Scene, road: Road) -> None:
    """Paint what a kind of road has, with random wear, and mend it."""
    rng, half, marks = scene.rng, road.course.half, road.kind.marks
    paint = plain(scene, "line", 0.7, vary=0.5)
    if marks == "bays":
        _mark_bays(scene, road)
    elif marks == "motorway":
        _mark_motorway(scene, road)
    elif marks:
        if scene.chance(0.75):
            _mark_lanes(scene, road, paint)
        if scene.chance(0.4):
            for side in (-1, 1):
                _paint(scene, road, side * (half - _sample_shoulder(scene, half)), 0.06, paint)
        if road.name != "rural" and scene.chance(0.35):
            first = rng.randint(START + 2, START + 20)
            for k in range(int(half * 2)):
                _paint(scene, road, k + 0.5 - half, 0.25, paint, (first, first + 3))
    if not road.kind.surface.keys() & {"asphalt", "setts"}:
        return
    for _ in range(rng.choice([0, 0, 2, 6])):  # where a trench was mended
        patch = plain(scene, sample_grey(scene), 0.9, vary=0.3)
        first, middle = rng.randint(START, START + 40), rng.uniform(-0.9, 0.9) * half
        wide = min(rng.choice([0.3, 0.3, rng.uniform(0.3, 1.2)]), half - abs(middle))
        span = (first, first + rng.choice([2, 3, 12]))
        line = [(middle - wide, 0.0335), (middle + wide, 0.0335)]
        sweep(scene, road, line, patch, road.truth, span)


def _sample_shoulder(scene: Scene, half: float) -> float:
    """Sample the width in metres beyond an edge line: little, or a shoulder to stop on."""
    rng = scene.rng
    return min(rng.uniform(1.2, 3.2) if scene.chance(0.25) else rng.uniform(0.15, 0.7), half - 1)


def _paint(
    scene: Scene, road: Road, middle: float, half: float, paint: Material, span: Span = (0, FAR)
) -> None:
    """Paint a line along the road; ``middle`` from the road's, half its width in metres."""
    line = [(middle - half, 0.036), (middle + half, 0.036)]
    sweep(scene, road, line, paint, road.truth, span)


def _mark_lanes(scene: Scene, road: Road, paint: Material) -> None:
    """Paint lines between lanes, dashed between those of one direction."""
    for (left, way), (right, opposite) in pairwise(sorted(road.lanes)):
        line = (left + right) / 2
        if way != opposite and scene.chance(0.5):
            if right - left < 4.5:  # no island between them
                _paint(scene, road, line, 0.07, paint)
            continue
        _dash(scene, road, line, paint)


def _dash(scene: Scene, road: Road, across: float, paint: Material) -> None:
    long = scene.rng.choice([3, 4])
    for first in range(0, FAR, long + 3):
        _paint(scene, road, across, 0.07, paint, (first, first + long))


def _mark_motorway(scene: Scene, road: Road) -> None:
    """Paint edge lines beside shoulders, lines between lanes."""
    rng, half = scene.rng, road.course.half
    left, right = rng.sample([_sample_shoulder(scene, half), rng.uniform(0.15, 1.2)], 2)
    low, high, white = left - half, half - right, plain(scene, "line", 0.7, vary=0.5)
    for inner, outer in ((low, -half), (high, half)):
        if abs(outer - inner) > 1 and scene.chance(0.4):  # a shoulder of another asphalt
            shoulder = pave(scene, sample_paving(scene, [sample_grey(scene)], {"asphalt": 1}))
            strip = sorted([(inner, 0.033), (outer, 0.033)])
            sweep(scene, road, strip, shoulder, ROAD, (0, FAR))
        paint = rng.choice([white, plain(scene, "line", 0.7, vary=0.5)])
        _paint(scene, road, inner, rng.uniform(0.06, 0.14), paint)
    lanes = max(1, round((high - low) / rng.uniform(3.3, 4.2)))
    for lane in range(1, lanes):
        _dash(scene, road, low + (high - low) * lane / lanes, white)


def _mark_bays(scene: Scene, road: Road) -> None:
    """Paint the lines of a car park."""
    if scene.chance(0.4):
        return
    white, half = plain(scene, "line", 0.7, vary=0.5), road.course.half
    for side in (-1, 1):
        for first in range(0, road.length - 3, 2):
            ends = [road.course.position(first, side * out, 0.036) for out in (half - 5, half)]
            points = [*ends, *[(x, y + 0.12, z) for x, y, z in ends]]
            scene.put_surface(points, [(0, 1, 3, 2)], white, ROAD)
