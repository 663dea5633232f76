"""The streets that the tests of all areas look at: rendered ones, made once each."""

from functools import cache

from torch import Tensor

from roadtorch.scenes import render_scene

scene = cache(render_scene)
"""A rendered street with its truth: ``scene(seed, height, width, dusk=…)``, each made once.

The tensors are shared by all tests: clone what is to be changed.
"""


def as_bytes(image: Tensor) -> Tensor:
    """An image with the 256 levels that a file would give it."""
    return (image * 255).round() / 255


def lost_highlights(**options: float) -> Tensor:
    """A small street (3,96,128), saturated on its road: in a patch, and in single pixels."""
    image = scene(3, 96, 128, **options).image.clone()
    image[:, 60:72, 20:44] = 1.0
    image[:, 76:88, 70:100:3] = 1.0
    return image
