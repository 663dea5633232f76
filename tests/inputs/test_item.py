"""Some items of a source: chosen, evenly spaced, and the source closed in the end."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.inputs.item import Item, Selection, Source, spread


def item(number: int, seconds: float | None = None) -> Item:
    read = lambda: torch.zeros(3, 2, 2)  # noqa: E731
    return Item(f"{number}", f"{number}", read, number=number, seconds=seconds)


@pytest.mark.parametrize(
    ("count", "known", "expected"),
    [
        (100, True, [0, 33, 66]),
        (2, True, [0, 1]),
        (100, False, [0, 1, 2]),
        (0, True, []),
    ],
)
def test_sampled_items_are_evenly_spaced(count: int, known: bool, expected: list[int]) -> None:
    asked: list[int] = []
    closed: list[bool] = []

    def items() -> Iterator[Item]:
        try:
            for number in range(count):
                asked.append(number)
                yield item(number)
        finally:
            closed.append(True)

    opened = items()  # held here, so that it is not closed by itself
    source = Source("a", "a", lambda: opened, count=count if known else None)

    assert [one.number for one in source.sampled(3).items()] == expected
    assert len(asked) <= (expected[-1] + 1 if expected else 0)
    assert closed == [True]


@pytest.mark.parametrize(
    ("selection", "clock", "expected"),
    [
        (Selection(), True, [0, 1, 2, 3, 4, 5]),
        (Selection(every=2, start=0.1, limit=2), True, [1, 3]),
        (Selection(start=0.2, end=0.4), True, [2, 3]),
        (Selection(start=2, end=4), False, [2, 3]),  # one a second
    ],
)
def test_selections(selection: Selection, clock: bool, expected: list[int]) -> None:
    items = (item(number, number / 10 if clock else None) for number in range(6))

    assert [one.number for one in selection.of(items)] == expected


def test_pictures_have_no_time_and_values_are_spread() -> None:
    assert Selection(every=2, limit=2).of_pictures("abcdef") == "ac"
    with pytest.raises(ConfigError, match="pictures have no time"):
        Selection(start=1).of_pictures("abc")
    assert [*spread(range(10), 3)] == [0, 4, 8]
    assert [*spread(range(2), 3)] == [0, 1]


def test_time_stamps_and_files() -> None:
    assert item(3).nanoseconds == 3_000_000_000
    assert item(3, 0.5).nanoseconds == 500_000_000
    assert Item("a", "a", torch.rand, seconds=0.5, stamp=7).nanoseconds == 7
    assert Item("sub/a", "in/sub/a.png", torch.rand, suffix=".png").row_name == "sub/a.png"
    assert Item("a", "a", torch.rand, file=Path("a.png")).path == Path("a.png")
    with pytest.raises(InputError, match=r"s3://b/a: is not on this machine \(give files"):
        assert Item("a", "s3://b/a", torch.rand).path
