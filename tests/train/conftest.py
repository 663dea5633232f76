"""Footage, labelled pictures and a finished run that the tests of training share."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch

from roadtorch.train.config import Training
from roadtorch.train.run import Request, train
from tests.train.runs import request_of, training_of, write_streets


@contextmanager
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    with one_thread():
        yield


@pytest.fixture(scope="session")
def streets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_streets(tmp_path_factory.mktemp("footage"), 5)


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Labelled pictures are shared by the tests: one folder a kind."""
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="session")
def shared_run(
    streets: Path, kept: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Training, Request]:
    folder = tmp_path_factory.mktemp("finished")
    training = training_of("patches", folder)
    request = request_of(streets, kept, folder / "run", "patches")
    with one_thread():
        train(training, request)
    return training, request


@pytest.fixture
def finished(shared_run: tuple[Training, Request], tmp_path: Path) -> tuple[Training, Request]:
    """A finished run on patches, a copy that a test may change; and the request to go on."""
    training, request = shared_run
    out = shutil.copytree(request.out, tmp_path / "finished")
    return training, Request(request.images, out, True, request.prepared, request.quiet)
