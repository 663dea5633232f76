"""Small runs that the tests of training share: rendered streets, tiny networks."""

import csv
import os
import signal
import tomllib
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadtorch.base.settings import merge, parse_assignments
from roadtorch.testing.scenes import write_image
from roadtorch.train.config import Training, build_training
from roadtorch.train.source import EGO_CODE, ROAD_CODE, VOID_CODE
from roadtorch.train.training_loop import Batch, Loop
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
width = 64
narrow = 8
wide = 8

[teacher]
detector = "labeller"
working = { pixels = 4800 }

[descent]
batch = 2
method = "adam"
learning_rate = 0.01

[stopping]
rule = "epochs"
epochs = 2
"""


SELF_TRAINING = """
kind = "self-training"
samples_per_epoch = 4
sizes = [[32, 64], [64, 64]]
upper_rows = [0.0, 0.25]

[network]
height = 32
width = 64
wide = 8
narrow = 8

[augmentation]
ego_car = 0.5

[[rounds]]
epochs = 1
backbone_factor = 0.0

[[rounds]]
epochs = 1
backbone_factor = 0.4
target = 0.5

[descent]
batch = 2
method = "adam"
learning_rate = 0.01
ema = 0.5
"""

CONFIGS = {"patches": PATCHES, "images": IMAGES, "self-training": SELF_TRAINING}


def write_streets(folder: Path, count: int) -> Path:
    """Write images of rendered streets to a folder."""
    for seed in range(count):
        write_image(folder / f"street_{seed}.png", scene(seed, 60, 80))
    return folder


def write_worlds(folder: Path, names: Sequence[str], ego_rows: int = 0) -> Path:
    """Write rendered streets as ``train.worlds`` does, the ego car at the bottom."""
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    for seed, name in enumerate(names):
        street = scene(seed, 60, 80)
        write_image(folder / "images" / f"{name}.jpg", street)
        codes = np.where(street.road, np.uint8(ROAD_CODE), street.layout)
        codes[street.void] = VOID_CODE
        codes[60 - ego_rows :] = EGO_CODE
        cv2.imwrite(str(folder / "truth" / f"{name}.png"), codes)
    return folder


def write_config(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def training_of(kind: str, *changes: str) -> Training:
    return build_training(merge(tomllib.loads(CONFIGS[kind]), parse_assignments(changes)))


def rows_of(out: Path) -> list[dict[str, str]]:
    with (out / "log.csv").open(newline="") as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


def interrupt_after(steps: int, patch: pytest.MonkeyPatch) -> None:
    """Send this process SIGTERM in the middle of its n-th step from now."""
    original, remaining = Loop.step, [steps]

    def step(loop: Loop, batch: Batch) -> float:
        remaining[0] -= 1
        if remaining[0] == 0:
            os.kill(os.getpid(), signal.SIGTERM)
        return original(loop, batch)

    patch.setattr(Loop, "step", step)
