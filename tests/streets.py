"""Rendered streets for all tests, each rendered once."""

from functools import cache
from pathlib import Path

import cv2
import torch
from torch import Tensor

from roadtorch.testing.scenes import RenderedScene, render_scene, write_image

scene = cache(render_scene)
"""A rendered street with its truth: ``scene(seed, height, width, dusk=…)``, each made once.

All tests share the tensors: clone one before changing it.
"""


def as_bytes(image: Tensor) -> Tensor:
    """Round an image to the 256 levels of a file."""
    return (image * 255).round() / 255


def saturated_street(**options: float) -> Tensor:
    """Return a street (3, 96, 128), saturated on the road in a patch and in single pixels."""
    image = scene(3, 96, 128, **options).image.clone()
    image[:, 60:72, 20:44] = 1.0
    image[:, 76:88, 70:100:3] = 1.0
    return image


def write_camvid(root: Path, split: str, scenes: dict[str, RenderedScene]) -> None:
    """Write scenes by name in CamVid's layout: ROOT/SPLIT/NAME.png, ROOT/SPLITannot/NAME.png."""
    (root / f"{split}annot").mkdir(parents=True, exist_ok=True)
    for name, scene in scenes.items():
        write_image(root / split / f"{name}.png", scene)
        cv2.imwrite(str(root / f"{split}annot" / f"{name}.png"), scene.classes.numpy())


def write_drives(root: Path) -> None:
    """Write CamVid's three development drives, one small image each, into ``root/camvid``."""
    names = ("0001TP_0", "0006R0_1")
    scenes = {name: render_scene(seed, 48, 64) for seed, name in enumerate(names)}
    write_camvid(root / "camvid", "train", scenes)
    write_camvid(root / "camvid", "val", {"0016E5_7959": render_scene(2, 48, 64)})


def bonnet(height: int, width: int, rise: float = 0.18) -> Tensor:
    """Return an ego car, bool (H, W): an arch at the bottom edge, ``rise`` high in its middle."""
    rows = (torch.arange(height) + 0.5) / height
    columns = (torch.arange(width) + 0.5) / width
    top = 1 - rise * (1 - ((columns - 0.5) / 0.42).square())
    return rows[:, None] > top


@cache
def drive(count: int = 12, rise: float = 0.18, height: int = 120, width: int = 160) -> list[Tensor]:
    """Return frames (3, H, W) of different streets by one camera over its bonnet; 0 for none.

    The bonnet is dark blue with a pale edge, and reflects a little of each sky.
    """
    frames = []
    for seed in range(count):
        image = scene(seed, height, width, horizon=0.42, dusk=0.0).image.clone()
        if rise:
            car, inner = bonnet(height, width, rise), bonnet(height, width, rise - 0.02)
            paint = torch.tensor([0.1, 0.15, 0.3]).view(3, 1, 1) + 0.1 * image.flip(1)
            image = torch.where(car, torch.where(inner, paint, 0.8), image)
        frames.append(image)
    return frames
