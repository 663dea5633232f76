"""What detectors said when it was last written down: a change is meant, or a fault."""

import json
from itertools import chain
from pathlib import Path

import pytest
import torch

from scripts import freeze

FROZEN = json.loads((Path(__file__).parent / "frozen.json").read_text(encoding="utf-8"))
AWAY = 4.0  # 255ths: how far another machine's arithmetic may move a likelihood, on average


@pytest.fixture(scope="module")
def now() -> dict[str, list[list[int]]]:
    """With two threads, which other tests do without."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        return freeze.thumbnails()
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize("name", FROZEN)
def test_a_detector_says_what_it_said(name: str, now: dict[str, list[list[int]]]) -> None:
    """Meant to change? `python scripts/freeze.py thumbnails tests/frozen.json` writes it anew."""
    before, after = (list(chain(*maps[name])) for maps in (FROZEN, now))

    assert len(before) == len(after) == 2 * 6 * 8
    away = sum(abs(one - two) for one, two in zip(before, after, strict=True)) / len(before)
    assert away <= AWAY


def test_every_detector_is_written_down() -> None:
    assert list(FROZEN) == freeze.detectors()
