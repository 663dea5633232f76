"""Settings for ``scripts/fuzz.py``: TOML files, texts of ``--set``, files of cameras."""

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from roadtorch.camera.camera import Camera
from roadtorch.camera.look import Look
from roadtorch.cli.config import as_toml, chosen_detector
from roadtorch.detectors.catalogue import detector_entry, list_detectors
from roadtorch.errors import ConfigError, InputError, RoadtorchError
from roadtorch.road.ego import Ego, ego_car
from roadtorch.settings import build_settings, parse_assignments
from roadtorch.train.config import build_training
from scripts.fuzz_bytes import TEXT, a_piece, mutated

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
KEYS = ("threshold", "texture.bins", "ego.bottom", "ego.outline", "seed_area.height", "road", "x.y")


def told_of(path: Path, build: Callable[[], object]) -> None:
    """Build settings; a refusal that names their key names their file too, as a user knows it."""
    try:
        build()
    except ConfigError as problem:
        raise ConfigError(f"{path} {problem.where}", problem.what, problem.remedy) from None


def make_config(folder: Path, draw: random.Random) -> Path:
    """A TOML file of a detector or of a training that was tampered with."""
    path = folder / "config.toml"
    if draw.random() < 0.4:
        data = draw.choice(sorted(CONFIGS.glob("*.toml"))).read_bytes()
    else:
        entry = detector_entry(draw.choice(list_detectors("*")))
        data = as_toml(entry.name, build_settings(entry.settings, {})).encode()
    path.write_bytes(mutated(data, draw, TEXT))
    return path


def read_config(path: Path) -> bool:
    """Build the detector's settings, and those of a training where it says its kind."""
    told_of(path, lambda: _build(path))
    return True


def _build(path: Path) -> object:
    name, values = chosen_detector(None, path, (), None)
    if "kind" in values:
        return build_training(values)
    return build_settings(detector_entry(name).settings, values)


def make_assignments(folder: Path, draw: random.Random) -> Path:
    """A file with texts of ``--set``, one a line."""
    path = folder / "sets.txt"
    texts = [b"%s=%s" % (draw.choice(KEYS).encode(), a_piece(draw)) for _ in range(3)]
    data = b"\n".join([*texts, b"threshold=0.5", b"ego.outline=[0.9, 1]"])
    path.write_bytes(mutated(data, draw, TEXT))
    return path


def read_assignments(path: Path) -> bool:
    """Build a detector's settings from them."""
    texts = path.read_bytes().decode("utf-8", "surrogateescape").split("\n")
    settings = detector_entry("cpf").settings
    told_of(path, lambda: build_settings(settings, parse_assignments(texts)))
    return True


def make_camera(folder: Path, draw: random.Random) -> Path:
    """A camera's file that was tampered with."""
    path = folder / "camera.toml"
    rows = (0.9, 0.92, 0.95)
    look = Look(rows=rows, columns=rows, across=(0.1, -0.2, 0.3), down=(0.5, 0.1, 0.0))
    ego = Ego(outline=(0.9, 0.8, 0.9))
    camera = Camera(width=64, height=48, frames=9, horizon=0.4, seed_row=0.9, ego=ego, look=look)
    camera.write(path)
    path.write_bytes(mutated(path.read_bytes(), draw, TEXT))
    return path


def read_camera(path: Path) -> bool:
    """Read it and hold a picture against it; whether the ego car leaves something free."""
    camera = Camera.read(path)
    image = torch.rand(3, 48, 64)
    try:
        camera.check(image)
        return not bool(ego_car(image, camera.ego).all())
    except InputError as problem:  # of the picture: it is not of that camera
        return _is_refusal(problem)


def _is_refusal(problem: RoadtorchError) -> Any:
    return bool(problem.what and problem.remedy)
