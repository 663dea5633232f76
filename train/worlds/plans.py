"""Plans of worlds by number: kind of road, time of day, weather, people, camera mount."""

from collections.abc import Mapping
from typing import NamedTuple

KINDS: Mapping[str, int] = {
    "street": 5,
    "rural": 4,
    "motorway": 2,
    "track": 5,
    "trail": 3,
    "overgrown": 10,
    "yard": 2,
    "bazaar": 3,
    "lane": 2,
}
"""Kinds of road in worlds of all kinds, with their weights."""

NOWHERE = "nowhere"
"""Kind of a place without road."""

FISHEYES = ("front", "rear", "left", "right")
"""Mounts of fisheyes on a car; other mounts are car, truck and robot."""

HOURS = {"sun": 9, "overcast": 7, "dusk": 2, "night": 3}
"""Times of day, with their weights."""

DARKER = {"sun": 6, "overcast": 6, "dusk": 4, "night": 5}
DAY = {"sun": 5, "overcast": 4, "dusk": 3}
NIGHT = {"night": 1}
RAINY = {"overcast": 6, "dusk": 3, "night": 2}


class Plan(NamedTuple):
    """The distributions from which a world is sampled.

    name: part of the file's name; "" stands for the kind of road. kinds, hours: with their weights.
    wet: whether it rains on a wet road; None samples it. crowd: whether many people, cyclists and
    small obstacles are near and on the road. mount: of the camera. hand: the side on which traffic
    keeps in a town, 1 right, -1 left; 0 samples it.
    """

    name: str
    kinds: Mapping[str, int]
    hours: Mapping[str, int] = HOURS
    wet: bool | None = None
    crowd: bool = False
    mount: str = "car"
    hand: int = 0


TOWN = {"town": 1}
DRY_TOWN = Plan("town", TOWN, DAY, wet=False)
DARK_TOWN = Plan("town", TOWN, NIGHT)
WET_TOWN = Plan("townrain", TOWN, RAINY, wet=True)
PEOPLE = Plan("people", {"town": 4, "street": 1, "bazaar": 1}, DARKER, crowd=True)
SURROUND = {"town": 6, "street": 2, "yard": 3, "rural": 1, "lane": 1, "track": 1}
FRONT, REAR, LEFT, RIGHT = (
    Plan(f"fisheye{name}", SURROUND, DARKER, mount=mount)
    for name, mount in (("front", "front"), ("rear", "rear"), ("side", "left"), ("side", "right"))
)
TRUCK = Plan("truck", {"town": 4, "motorway": 2, "rural": 2, "yard": 1}, DARKER, mount="truck")
ROBOT = Plan("robot", {"town": 4, "yard": 1, "lane": 1, "trail": 1}, DARKER, mount="robot")
ROADS = {"ramp": 3, "motorway": 2, "rural": 2}
LITTER = {"litter": 1}
MIXED = Plan("", KINDS, DARKER)

SCHEDULE = (
    *(DRY_TOWN, DARK_TOWN, FRONT, WET_TOWN, PEOPLE, Plan("", LITTER, DARKER)),
    *(DARK_TOWN, LEFT, DRY_TOWN, MIXED, WET_TOWN, PEOPLE),
    *(REAR, DARK_TOWN, TRUCK, WET_TOWN, MIXED, DRY_TOWN),
    *(PEOPLE, RIGHT, DARK_TOWN, Plan("", ROADS, DARKER), WET_TOWN, ROBOT),
    *(DRY_TOWN, PEOPLE, MIXED, Plan("", {NOWHERE: 1}, DARKER)),
)
"""Plans in turn, so that any range of numbers is balanced."""

STREETS = tuple(
    plan._replace(hand=hand)
    for plan in (
        *(DRY_TOWN, DARK_TOWN, WET_TOWN._replace(crowd=True), FRONT),
        *(DRY_TOWN._replace(crowd=True), DARK_TOWN, WET_TOWN, TRUCK),
        *(DRY_TOWN, DARK_TOWN._replace(crowd=True), WET_TOWN, LEFT),
        *(DRY_TOWN, DARK_TOWN._replace(crowd=True), WET_TOWN._replace(crowd=True), FRONT),
        *(DRY_TOWN._replace(crowd=True), DARK_TOWN, WET_TOWN, REAR),
        *(DRY_TOWN, DARK_TOWN, WET_TOWN._replace(crowd=True), RIGHT, ROBOT),
    )
    for hand in (1, -1)
)
"""Plans in turn of towns above all: a third of them by day, by night and in the rain, half of them
with traffic that keeps right. A fifth of the worlds are fisheyes, a few trucks and robots."""

SCHEDULED, TOWNS = 30000, 40000
"""First numbers of worlds planned in turn by ``SCHEDULE`` and by ``STREETS``."""

HELD_OUT = 9000
"""From which of each ten thousand on numbers are held out from training."""

RANGES = {
    0: Plan("", KINDS),
    10000: Plan("", TOWN),
    12000: Plan("", ROADS),
    14000: Plan("", LITTER),
    20000: Plan("", {NOWHERE: 1}),
}
"""Plans by first number, below those planned in turn."""


def plan_world(number: int) -> Plan:
    """Return the plan of a world's number."""
    if number >= TOWNS:
        return STREETS[(number - TOWNS) % len(STREETS)]
    if number >= SCHEDULED:
        return SCHEDULE[(number - SCHEDULED) % len(SCHEDULE)]
    return RANGES[max(first for first in RANGES if first <= number)]
