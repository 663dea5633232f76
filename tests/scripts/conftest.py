"""Scripts called in this process, which has imported already what they need."""

import sys
from collections.abc import Callable, Iterator
from types import ModuleType

import cv2
import pytest
import torch

PrintedBy = Callable[..., str]


@pytest.fixture
def _threads_as_before() -> Iterator[None]:
    before, of_opencv = torch.get_num_threads(), cv2.getNumThreads()
    yield
    torch.set_num_threads(before)
    cv2.setNumThreads(of_opencv)


@pytest.fixture
def printed_by(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    _threads_as_before: None,
) -> PrintedBy:
    """``printed_by(bench, "--rounds", 1)``: what a script's ``main`` prints; it may return 0."""

    def run(script: ModuleType, *words: object) -> str:
        monkeypatch.setattr(sys, "argv", [str(script.__file__), *map(str, words)])
        assert not script.main()
        return capsys.readouterr().out

    return run
