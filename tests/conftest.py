"""Fixtures and settings of all tests: no network, fixed seeds, one thread of torch."""

import math
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import pytest
import torch

from roadtorch.base import progress
from tests.command import call, footage

__all__ = ["call", "footage"]

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

UNTIMED: dict[str, Any] = {
    "database": None,
    "deadline": None,
    "suppress_health_check": [hypothesis.HealthCheck.too_slow],
}
hypothesis.settings.register_profile("settled", derandomize=True, **UNTIMED)
hypothesis.settings.register_profile("long", max_examples=5_000, **UNTIMED)
hypothesis.settings.load_profile("settled")
torch.set_num_threads(1)  # with two, many small operations take twice the processor time


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Run the tests of a file in one process: what they share is then made once."""
    from xdist.scheduler import LoadScopeScheduling

    class FileScheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return "tests/export" if file.startswith("tests/export/") else file

    return FileScheduling(config, log)


@pytest.fixture(autouse=True)
def _no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail a test that connects anywhere but to a socket file or this machine's loopback."""
    connect = socket.socket.connect

    def refuse(self: socket.socket, address: Any) -> None:
        if self.family != getattr(socket, "AF_UNIX", None) and address[0] != "127.0.0.1":
            raise AssertionError(f"a test wanted to connect to {address}")
        connect(self, address)

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket.socket, "connect_ex", refuse)


@pytest.fixture(autouse=True)
def _no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """Print no line of progress, however long a busy machine takes."""
    monkeypatch.setattr(progress, "LINE_INTERVAL", math.inf)


@pytest.fixture(scope="session", autouse=True)
def _cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what is cached for the user in a folder of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        yield


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Return the folder of the development data, for tests with the marker ``data``."""
    if not DATA.is_dir():
        pytest.skip("the development data is not beside the repository (../shared/data)")
    return DATA
