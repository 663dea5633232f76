"""The command line called in this process, on a folder of images."""

from functools import partial
from pathlib import Path

import pytest

from tests.command import ROWS, Call


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Where results go; not there yet."""
    return tmp_path / "out"


@pytest.fixture
def run(call: Call, footage: Path, out: Path) -> Call:
    """``infer`` on the three images with the quickest detector, into ``out``."""
    return partial(call, "infer", footage, *ROWS, "--out", out)
