"""The street that the tests of the built-in detectors look at."""

from torch import Tensor

from roadtorch.scenes import render_scene


def lost_highlights(**options: float) -> Tensor:
    """A small street (3,96,128), saturated on its road: in a patch, and in single pixels."""
    image = render_scene(3, 96, 128, **options).image.clone()
    image[:, 60:72, 20:44] = 1.0
    image[:, 76:88, 70:100:3] = 1.0
    return image
