"""Where a long run is, told to a terminal and to a pipe."""

import io
import sys

import pytest

from roadtorch.base import progress
from roadtorch.base.progress import Progress


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
