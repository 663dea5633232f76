"""Footage, labelled images and a finished run that the tests of training share."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from roadtorch.train.config import Training
from roadtorch.train.run import Outcome, TrainingRequest, train
from tests.train.runs import training_of, write_streets

Trained = Callable[..., Outcome]


@pytest.fixture(scope="session")
def streets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_streets(tmp_path_factory.mktemp("footage"), 5)


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of labelled images that tests share, with one folder for each kind."""
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def trained(streets: Path, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """Return a function that runs a training on the streets.

    For example ``trained("images", "descent.ema=0.9", out="one")``; the folder is new unless
    ``out`` names one of this module.
    """
    runs = tmp_path_factory.mktemp("runs")

    def run(kind: str, *changes: str, out: str = "", **more: Any) -> Outcome:
        folder = runs / out if out else tmp_path_factory.mktemp("run") / "run"
        request = TrainingRequest(str(streets), folder, prepared=cache / kind, quiet=True)
        return train(training_of(kind, *changes), replace(request, **more))

    return run


@pytest.fixture(scope="session")
def shared_run(
    streets: Path, cache: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Training, TrainingRequest]:
    training, out = training_of("patches"), tmp_path_factory.mktemp("finished") / "run"
    request = TrainingRequest(str(streets), out, prepared=cache / "patches", quiet=True)
    train(training, request)
    return training, request


@pytest.fixture
def finished(
    shared_run: tuple[Training, TrainingRequest], tmp_path: Path
) -> tuple[Training, TrainingRequest]:
    """Return a finished run on patches, a copy that a test may change, and its request."""
    training, request = shared_run
    out = shutil.copytree(request.out, tmp_path / "finished")
    return training, replace(request, out=out)
