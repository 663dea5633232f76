"""Dark pictures brightened before they are looked at. Ours."""

import math

from pydantic import Field
from torch import Tensor

from roadtorch.imaging.order_statistics import order_statistic
from roadtorch.runtime.image_cache import cached_per_image
from roadtorch.settings import Settings

STRONGEST = 0.3
"""The exponent of the strongest brightening: 0.01 becomes 0.25."""

DARKEST = 1e-4
"""Pixels count as at least this bright, so that black stays nearly black under any gamma."""


class Exposure(Settings):
    """How dark pictures are brightened before they are looked at."""

    ground: float = Field(
        default=0.4, gt=0, lt=1, description="grey level that the lower part of a picture gets"
    )


@cached_per_image
def brightened(image: Tensor, exposure: Exposure) -> Tensor:
    """An image (3,H,W) in [0,1] under the gamma that lifts its lower part to ``ground``.

    At dusk all differences shrink; this restores them. The median of the grey image below
    0.55 of the height decides; pictures that are bright enough stay as they are, and the
    exponent is never below ``STRONGEST``. Ours, in place of P1's brightness equalisation.
    """
    lower = image[:, int(image.shape[1] * 0.55) :].mean(0).reshape(-1)
    grey = min(max(order_statistic(lower, (len(lower) - 1) // 2), 0.01), 0.99)
    exponent = min(max(math.log(exposure.ground) / math.log(grey), STRONGEST), 1.0)
    # As 2 to the log2, which is three times as fast as a power.
    return image if exponent == 1 else image.clamp_min(DARKEST).log2_().mul_(exponent).exp2_()
