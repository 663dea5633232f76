"""The horizon of one picture, from its layout and from where its lines meet. Ours.

Seen from a camera in a car, ground ends a little below the horizon: where it is hidden, or too
far to be told. The lines of the road meet on it. Either alone is wrong at times; how far they
agree tells how sure it is. Footage of one camera tells more: see ``camera_of``.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.camera.still import gradients, small_grey, small_size
from roadtorch.camera.vanishing_point import vanishing_point
from roadtorch.errors import InputError
from roadtorch.layout.classes import HORIZONTAL

HIGHEST = 0.05
"""Share of the columns that may show ground above the farthest ground: mislabelled ones."""

BELOW = 0.025
"""By which share of the height the farthest ground ends below the horizon: the median of 16
rendered streets and four pictures of KITTI's."""

LEAST_GROUND = 0.25
"""Share of the columns that have to end in ground."""

APART = 0.15
"""Share of the height by which both may differ."""

SURE = 0.025
"""Share of the height by which both were wrong where they agreed, root mean square."""

REMEDY = "give --pitch, or --camera with what roadtorch camera finds in footage"


class Horizon(NamedTuple):
    """Its row and how unsure that is, one standard deviation: shares of the height."""

    row: float
    spread: float


def horizon_of(image: Tensor, layout: Tensor) -> Horizon:
    """The horizon of an image (3,H,W) with the potentials (3,H,W) of its layout.

    Raises InputError where it cannot be told: hardly any ground, ground up to the upper edge, or
    lines that meet elsewhere.
    """
    if not torch.isfinite(layout).all():
        raise InputError("image", "has a layout that is not finite", REMEDY)
    height = layout.shape[-2]
    ground = layout.argmax(0) == HORIZONTAL
    run = ground.flip(0).int().cummin(0).values.sum(0)  # from the lower edge upwards
    if float((run > 0).double().mean()) < LEAST_GROUND:
        raise InputError("image", "shows too little ground to tell the horizon", REMEDY)
    top = float((height - run[run > 0].double()).quantile(HIGHEST)) / height
    if top <= 0:
        raise InputError("image", "shows ground up to its upper edge, no horizon", REMEDY)
    grey = small_grey(image, small_size([image]))
    meeting = vanishing_point(gradients([grey])).row
    shown, aimed = max(top - BELOW, 0.0), min(meeting, top)
    if abs(shown - meeting) > APART:
        what = f"has ground up to row {top:.2f}, but lines that meet at row {meeting:.2f}"
        raise InputError("image", what, REMEDY)
    return Horizon((shown + aimed) / 2, max(SURE, abs(shown - meeting) / 2))
