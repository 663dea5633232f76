"""Plans of worlds by number: ground, light, weather, crowd, camera mount, side of traffic.

A number's plan is one of a hundred in turn, of plans.csv. The pack on which networks learn is
train/worlds.csv, of 50000 to 52999. Numbers gave other images before bc195b6.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from train.worlds.tables import Row, read_table

ROADLESS = ("room", "things", "wall", "field", "water", "square")
"""Kinds of places without road."""

FISHEYES = ("front", "rear", "left", "right")
"""Mounts of fisheyes on a car; the other mounts are car, truck, robot, motorcycle and bicycle."""

RIDERS = ("motorcycle", "bicycle")

Weights = Mapping[str, float]


class Plan(NamedTuple):
    """The distributions from which a world is sampled, a row of plans.csv.

    name: part of the file's name; "" stands for the ground. ground, light: kinds with their
    weights. weather: "any", "dry", "rain" (on a wet road) or "flooded" (a mirror-like road).
    crowd: whether many people, cyclists and small obstacles are near and on the road. mount: of the
    camera. hand: the side on which traffic keeps, 1 right, -1 left.
    """

    name: str
    ground: Weights
    light: Weights
    weather: str
    crowd: int
    mount: str
    hand: int


def spread_evenly(rows: Iterable[Row]) -> tuple[Plan, ...]:
    """Return plans in turn, each as evenly spaced as its count allows, its side alternating."""
    turns = []
    for order, (*values, count) in enumerate(row.values() for row in rows):
        for turn in range(count):
            turns.append(((turn + 0.5) / count, order, Plan(*values, hand=(1, -1)[turn % 2])))
    return tuple(plan for *_, plan in sorted(turns, key=lambda turn: turn[:2]))


SCHEDULE = spread_evenly(read_table("plans"))


def plan_world(number: int) -> Plan:
    """Return the plan of a world's number."""
    return SCHEDULE[number % len(SCHEDULE)]
