"""Head lights of the car that carries the camera: low beams, aimed down and to the near side."""

from math import radians
from typing import Any

import bpy

from train.worlds.stage import Point, Stage


def put_head_lights(stage: Stage, middle: Point, heading: float) -> None:
    """Put two lamps about a point, each a narrow strong beam over a wide weak one.

    Low beams end below the horizon, reach far along the near kerb and leave the oncoming half dark.
    """
    at = stage.at
    hand = stage.hand or at.choice((-1, 1))
    watts, aside, soft = at.uniform(1500, 9000), at.uniform(1, 9), at.uniform(0.7, 1.0)
    far, near = at.uniform(5, 9), at.uniform(20, 36)  # degrees from upper to lower end
    cut, weaker = at.uniform(0.2, 1.2), at.uniform(0.12, 0.5)
    colour = (1, at.uniform(0.8, 0.97), at.uniform(0.6, 0.95))
    for side in (-0.6, 0.6):
        for power, tall, flat in ((watts, far, 5.0), (watts * weaker, near, 3.5)):
            light: Any = bpy.data.lights.new("head light", "SPOT")
            light.energy, light.spot_size, light.spot_blend = power, radians(tall), soft
            light.color, light.shadow_soft_size = colour, 0.06
            thing = stage.add("own head light", light, (middle[0] + side, middle[1], middle[2]))
            down, turn = radians(90 - cut - tall / 2), heading - hand * radians(aside)
            thing.rotation_euler, thing.scale = (down, 0, turn), (flat, 1, 1)
