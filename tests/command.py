"""Helpers that call the command line in this process, and read what it wrote."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click import Command
from click.testing import CliRunner, Result
from PIL import Image

from roadtorch.base.atomic import RESULTS_FILE
from roadtorch.cli import main

Call = Callable[..., Result]

GREY = ("--detector", "grey-uniformity")
ROWS = ("--detector", "prior:rows")


@pytest.fixture
def call() -> Call:
    """Return ``call("infer", path, "--out", out)``; results have exit_code, stdout and stderr."""

    def run(*arguments: object) -> Result:
        return CliRunner().invoke(main, [str(argument) for argument in arguments])

    return run


def invoke_command(command: Command, *arguments: object) -> Result:
    """Call one command without its group, and raise its exceptions."""
    words = [str(argument) for argument in arguments]
    result = CliRunner().invoke(command, words, obj=[command.name, *words])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def save_image(path: Path, seed: int = 0, size: tuple[int, int] = (64, 48)) -> Path:
    """Save a noisy image in the format of the suffix."""
    width, height = size
    pixels = np.random.default_rng(seed).integers(60, 200, (height, width, 3), np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)
    return path


@pytest.fixture
def footage(tmp_path: Path) -> Path:
    """Make a folder with a.jpg, b.png and sub/c.png."""
    root = tmp_path / "footage"
    for seed, name in enumerate(("a.jpg", "b.png", "sub/c.png")):
        save_image(root / name, seed)
    return root


def read_index_rows(out: Path) -> dict[str, dict[str, str]]:
    """Read the rows of index.csv by file."""
    with (out / "index.csv").open(newline="") as file:
        return {row["file"]: row for row in csv.DictReader(file)}


def files_in(folder: Path) -> set[str]:
    """Return the names of all files but the ledger of results."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != RESULTS_FILE)
    return {str(path.relative_to(folder)) for path in files}


def bytes_in(folder: Path) -> dict[str, bytes]:
    """Read all files but those that depend on time and machine."""
    names = files_in(folder) - {"index.csv", "run.json"}
    return {name: (folder / name).read_bytes() for name in names}
