"""Fixtures of run: ``infer`` in this process, on a folder of images."""

from functools import partial
from pathlib import Path

import pytest

from tests.command import ROWS, Call


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Return an output folder that does not exist yet."""
    return tmp_path / "out"


@pytest.fixture
def run(call: Call, footage: Path, out: Path) -> Call:
    """Return ``infer`` on three images with the fastest detector, into ``out``."""
    return partial(call, "infer", footage, *ROWS, "--out", out)
