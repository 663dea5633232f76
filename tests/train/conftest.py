"""Footage, labelled pictures and a finished run that the tests of training share."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from roadtorch.train.config import Training
from roadtorch.train.run import Outcome, Request, train
from tests.train.runs import training_of, write_streets

Trained = Callable[..., Outcome]


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


@pytest.fixture
def trained(streets: Path, kept: Path, tmp_path: Path) -> Trained:
    """``trained("pictures", "rounds.count=1", out="one", resume=True)``: a run on the streets."""

    def run(kind: str, *changes: str, out: str = "run", **more: Any) -> Outcome:
        request = Request(str(streets), tmp_path / out, prepared=kept / kind, quiet=True)
        return train(training_of(kind, *changes), replace(request, **more))

    return run


@pytest.fixture(scope="session")
def shared_run(
    streets: Path, kept: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Training, Request]:
    training, out = training_of("patches"), tmp_path_factory.mktemp("finished") / "run"
    request = Request(str(streets), out, prepared=kept / "patches", quiet=True)
    with one_thread():
        train(training, request)
    return training, request


@pytest.fixture
def finished(shared_run: tuple[Training, Request], tmp_path: Path) -> tuple[Training, Request]:
    """A finished run on patches, a copy that a test may change; and the request to go on."""
    training, request = shared_run
    out = shutil.copytree(request.out, tmp_path / "finished")
    return training, replace(request, out=out, resume=True)
