"""Small runs that the tests of training share: rendered streets, tiny networks."""

import csv
import tomllib
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.base.settings import merge, parse_assignments
from roadtorch.testing.scenes import write_image
from roadtorch.train.config import Training, build_training
from tests.streets import scene

PATCHES = """
kind = "patches"
shuffle_images = 2
passes = 2

[network.topology]
k2 = 4

[network.working]
pixels = 4800

[superpixels]
pixels = 100

[descent]
batch = 64

[stopping]
rule = "epochs"
epochs = 2
"""

IMAGES = """
kind = "images"

[network]
height = 32
width = 40
narrow = 8
wide = 8

[teacher]
detector = "labeller"
working = { pixels = 4800 }

[recordings]
separator = "_"
min_frames = 5

[augmentation.ego_car]
probability = 0.5

[descent]
batch = 2
method = "adam"
learning_rate = 0.01

[stopping]
rule = "epochs"
epochs = 2
"""


CONFIGS = {"patches": PATCHES, "images": IMAGES}


def write_streets(folder: Path, count: int) -> Path:
    """Write images of rendered streets to a folder."""
    for seed in range(count):
        write_image(folder / f"street_{seed}.png", scene(seed, 60, 80))
    return folder


def bonnet(height: int, width: int) -> Tensor:
    """Return the ego car bool (H, W) of ``write_bonnets``: round, a fifth of the height."""
    row = (torch.arange(height) + 0.5)[:, None] / height
    column = (torch.arange(width) + 0.5) / width * 2 - 1
    return row > 0.8 + 0.08 * column.square()


def write_bonnets(folder: Path, count: int) -> Path:
    """Write footage of one camera: rendered streets with the same dark bonnet below them."""
    paint = torch.tensor([0.25, 0.08, 0.08])[:, None, None]
    for seed in range(count):
        street = scene(seed, 60, 80, horizon=0.45)
        image = torch.where(bonnet(60, 80), paint, street.image)
        write_image(folder / f"bonnet_{seed}.png", replace(street, image=image))
    return folder


def write_config(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def training_of(kind: str, *changes: str) -> Training:
    return build_training(merge(tomllib.loads(CONFIGS[kind]), parse_assignments(changes)))


def rows_of(out: Path) -> list[dict[str, str]]:
    with (out / "log.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]
