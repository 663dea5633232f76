"""Footage and labelled pictures that the runs of a module share."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from tests.train.runs import write_streets


@pytest.fixture(scope="module")
def streets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_streets(tmp_path_factory.mktemp("footage"), 5)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labelled pictures are shared by the tests: one folder a kind."""
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
