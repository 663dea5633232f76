"""Fixtures of the command line's tests."""

from pathlib import Path

import pytest

from roadtorch.base.image import write_rgb
from tests.streets import drive


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a drive over a bonnet as images, and return the folder."""
    folder = tmp_path_factory.mktemp("drive")
    for number, frame in enumerate(drive()):
        write_rgb(folder / f"{number:02d}.png", frame)
    return folder
