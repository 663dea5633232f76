"""The streets that the tests of all areas look at: rendered ones, made once each."""

from functools import cache
from pathlib import Path

import cv2
from torch import Tensor

from roadtorch.scenes import RenderedScene, render_scene, write_picture

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


def write_camvid(root: Path, split: str, scenes: dict[str, RenderedScene]) -> None:
    """Write scenes by name in CamVid's layout: ROOT/SPLIT/NAME.png, ROOT/SPLITannot/NAME.png."""
    (root / f"{split}annot").mkdir(parents=True, exist_ok=True)
    for name, scene in scenes.items():
        write_picture(root / split / f"{name}.png", scene)
        cv2.imwrite(str(root / f"{split}annot" / f"{name}.png"), scene.classes.numpy())
