"""What is done to a picture before a network sees it."""

import math
from typing import Literal, NamedTuple

from pydantic import Field
from torch import Tensor

from roadtorch.imaging.exposure import Exposure, brightened
from roadtorch.settings import Settings

FIXED_MEAN, FIXED_GAIN = 0.5, 4.0
"""Levels in [0,1] become values from -2 to 2, near the unit variance that tanh likes."""

FLATTEST = 0.02
"""The least deviation that a picture is divided by: a flat one stays flat."""


class Normalisation(Settings):
    """What is done to a picture before a network sees it."""

    kind: Literal["fixed", "picture", "brightened", "brightened picture"] = Field(
        default="fixed",
        description="levels as they are; less the picture's mean colour, over its deviation; "
        "brightened as for the labeller; or first this, then that",
    )
    exposure: Exposure = Exposure()


class Normalised(NamedTuple):
    """pixels (3,H,W) of about zero mean; gain: by how much a difference of levels has grown."""

    pixels: Tensor
    gain: float


def normalise(image: Tensor, normalisation: Normalisation) -> Normalised:
    """An image (3,H,W) in [0,1] as the networks want it. Ours; P2 says "RGB pixel values"."""
    if normalisation.kind.startswith("brightened"):
        image = brightened(image, normalisation.exposure)
    if normalisation.kind.endswith("picture"):
        centred = image - image.mean((1, 2), keepdim=True)
        gain = 1 / max(math.sqrt(centred.square().mean()), FLATTEST)
        return Normalised(centred * gain, gain)
    return Normalised((image - FIXED_MEAN) * FIXED_GAIN, FIXED_GAIN)
