"""The streets that the tests of all areas look at: a drawn one, and rendered ones."""

from functools import cache

import torch
from torch import Tensor

from roadtorch.scenes import render_scene

scene = cache(render_scene)
"""A rendered street with its truth: ``scene(seed, height, width, dusk=…)``, each made once.

The tensors are shared by all tests: clone what is to be changed.
"""


def street(height: int, width: int, seed: int = 0) -> Tensor:
    """A noisy grey wedge under a pale sky (3,H,W) in [0,1]: enough of a street for a contract."""
    generator = torch.Generator().manual_seed(seed)
    rows = torch.linspace(0, 1, height).view(-1, 1)
    columns = torch.linspace(-1, 1, width).view(1, -1)
    road = (rows > 0.45) & (columns.abs() < rows - 0.3)
    colours = torch.tensor([[0.7, 0.8, 0.95], [0.3, 0.45, 0.2], [0.45, 0.45, 0.47]])
    classes = torch.where(road, 2, (rows > 0.45).long().expand(height, width))
    noise = torch.randn(3, height, width, generator=generator) * 0.04
    return (colours[classes].permute(2, 0, 1) + noise).clamp(0, 1)


def as_bytes(image: Tensor) -> Tensor:
    """An image with the 256 levels that a file would give it."""
    return (image * 255).round() / 255


def lost_highlights(**options: float) -> Tensor:
    """A small street (3,96,128), saturated on its road: in a patch, and in single pixels."""
    image = scene(3, 96, 128, **options).image.clone()
    image[:, 60:72, 20:44] = 1.0
    image[:, 76:88, 70:100:3] = 1.0
    return image
