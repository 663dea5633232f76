"""A folder of small rendered streets, and a session on it with a fast detector."""

import shutil
from pathlib import Path

import pytest

from roadtorch.annotate.session import Session, open_session
from roadtorch.detectors.catalogue import load_detector
from roadtorch.testing.scenes import write_image
from tests.streets import scene


def write_streets(folder: Path, count: int = 3) -> Path:
    """Write street_0.png, street_1.png, …, 64 by 48."""
    for seed in range(count):
        write_image(folder / f"street_{seed}.png", scene(seed, 48, 64))
    return folder


@pytest.fixture(scope="session")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_streets(tmp_path_factory.mktemp("rendered"))


@pytest.fixture
def streets(rendered: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(rendered, tmp_path / "streets"))


@pytest.fixture
def session(streets: Path, tmp_path: Path) -> Session:
    out = tmp_path / "corrections"
    out.mkdir()
    return open_session(streets, out, load_detector("prior:triangle"))
