"""A folder of small rendered streets, and a session over it with a detector that is quick."""

from pathlib import Path

import pytest

from roadtorch.annotate.machine import AnnotationSettings
from roadtorch.annotate.serving import opened_session
from roadtorch.annotate.session import Session
from roadtorch.detectors.catalogue import load_detector
from roadtorch.scenes.street import write_picture
from tests.streets import scene


def write_streets(folder: Path, count: int = 3) -> Path:
    """street_0.png and so on, 64 by 48."""
    for seed in range(count):
        write_picture(folder / f"street_{seed}.png", scene(seed, 48, 64))
    return folder


@pytest.fixture
def streets(tmp_path: Path) -> Path:
    return write_streets(tmp_path / "streets")


@pytest.fixture
def session(streets: Path, tmp_path: Path) -> Session:
    out = tmp_path / "corrections"
    out.mkdir()
    return opened_session(streets, out, load_detector("prior:triangle"), AnnotationSettings())
