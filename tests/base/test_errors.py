"""Errors and progress: what they say."""

import io
import pickle
import sys
from pathlib import Path

import pytest

from roadtorch.base import progress
from roadtorch.base.errors import (
    ConfigError,
    DatasetError,
    InputError,
    RoadtorchError,
    WeightsError,
    unknown_name,
)
from roadtorch.base.progress import Progress


@pytest.mark.parametrize("kind", [InputError, ConfigError, DatasetError, WeightsError])
def test_errors_survive_a_process_boundary_and_are_short(kind: type[RoadtorchError]) -> None:
    path = Path("/".join(["folder"] * 100)) / "a.png"
    error = kind("k" * 10_000, f"holds {'x' * 100_000} pixels", "replace the file")

    assert len(str(error)) < 900
    assert str(error).endswith("x pixels (replace the file)")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (kind, str(error))
    assert isinstance(again, RoadtorchError)
    assert str(path) in str(InputError(path, "is empty", "replace the file"))


@pytest.mark.parametrize(
    ("name", "remedy"), [("fuson", "did you mean fusion?"), ("zzz", "known: cpf, fusion, lbp")]
)
def test_an_unknown_name_is_told_the_nearest_or_all(name: str, remedy: str) -> None:
    error = unknown_name("detector", name, ["lbp", "fusion", "cpf"])

    assert str(error) == f"{name}: unknown detector ({remedy})"


# --- progress -----------------------------------------------------------------------------


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("items", "options", "lines"),
    [
        ([1, 2], {"unit": "image"}, ["50 % (1 of 2 images), ", "100 % (2 of 2"]),
        (iter([1]), {"unit": "frame", "desc": "ego"}, ["ego: 1 frames in 00:00"]),
        ([1, 2], {"unit": "image", "quiet": True}, []),
    ],
)
def test_a_pipe_gets_a_line_when_it_is_due(monkeypatch, capsys, items, options, lines):
    monkeypatch.setattr(progress, "LINE_EVERY", 1e-9)

    for _ in Progress(items, **options):
        Progress.write("a.jpg: is empty", file=sys.stderr)

    told = capsys.readouterr().err
    assert "\r" not in told
    own = [line for line in told.splitlines() if line != "a.jpg: is empty"]
    for line, wanted in zip(own, lines, strict=True):
        assert line.startswith(f"roadtorch: {wanted}")


def test_a_short_run_says_nothing_to_a_pipe_and_draws_its_bar_on_a_terminal(monkeypatch, capsys):
    list(Progress([1, 2], unit="image"))
    assert capsys.readouterr().err == ""

    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    list(Progress([1, 2], unit="image"))
    assert "100%|" in terminal.getvalue()
