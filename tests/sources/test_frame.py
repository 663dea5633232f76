"""Frames of a source: some of them, evenly spaced."""

from collections.abc import Iterator

import pytest
import torch

from roadtorch.sources.frame import Frame, Source, sampled


@pytest.mark.parametrize(
    ("count", "known", "expected"),
    [
        (100, True, [0, 33, 66]),
        (3, True, [0, 1, 2]),
        (2, True, [0, 1]),
        (100, False, [0, 1, 2]),
        (0, True, []),
    ],
)
def test_some_frames_are_evenly_spaced(count: int, known: bool, expected: list[int]) -> None:
    asked: list[int] = []
    closed: list[bool] = []

    def frames() -> Iterator[Frame]:
        try:
            for number in range(count):
                asked.append(number)
                yield Frame(number, f"{number}", f"{number}", None, lambda: torch.zeros(3, 2, 2))
        finally:
            closed.append(True)

    opened = frames()  # held here, so that it is not closed by itself
    source = Source("a", "a", True, lambda: opened, count=count if known else None)
    found = sampled(source, 3)

    assert [frame.number for frame in found.frames()] == expected
    assert len(asked) <= (expected[-1] + 1 if expected else 0)
    assert closed == [True]
