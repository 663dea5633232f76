"""Choosing how far to trust corrected weights: what is wrong how near an outline, and the rows."""

from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from roadtorch.data.dataset import Item
from train import choose_corrections
from train.choose_corrections import (
    CENTRES,
    DETAILS,
    Tried,
    at_outline,
    row,
    told_wrong,
    wrong_pixels,
)
from train.study_corrections import Curve


def test_near_an_outline_are_both_its_sides() -> None:
    road = torch.zeros(5, 9, dtype=torch.bool)
    road[:, 5:] = True
    assert at_outline(road, 1)[2].nonzero()[:, 0].tolist() == [4, 5]
    assert at_outline(road, 2)[2].nonzero()[:, 0].tolist() == [3, 4, 5, 6]
    assert not at_outline(torch.ones_like(road), 2).any()


def test_wrong_pixels_are_counted_by_their_distance_to_an_outline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    road = torch.zeros(1, 40, dtype=torch.bool)
    road[:, 20:] = True
    mask, valid = road.clone(), torch.ones_like(road)
    mask[:, [19, 16, 0]] = True  # 1, 4 and 20 pixels from the road
    mask[:, [20, 27]] = False  # 1 and 8 pixels inside
    valid[:, 0] = False
    scene = SimpleNamespace(image=None, truth=SimpleNamespace(road=road, valid=valid))
    detector = SimpleNamespace(detect=lambda image: SimpleNamespace(mask=mask))
    monkeypatch.setattr(choose_corrections, "read_scene", lambda dataset, item: scene)
    item = Item("a", Path("a.png"), Path("a.png"))

    wrong = wrong_pixels(detector, Curve("a", None, (), (item,)))  # type: ignore[arg-type]

    assert wrong.tolist() == [[1, 1, 0, 0], [1, 0, 1, 0]]
    assert told_wrong(wrong) == [
        "| not road called road | 25% | 25% | 0% | 0% | 50% |",
        "| road missed | 25% | 0% | 25% | 0% | 50% |",
    ]


def test_a_row_has_first_all_details_as_they_ship() -> None:
    found = [Tried(detail, one, 0.9, detail / 10) for detail in DETAILS for one in CENTRES]
    cells = row("a", 5, found).split(" | ")
    assert len(cells) == 2 + 2 * len(DETAILS)
    assert cells[2] == "0.900 / 0.050"
    assert cells[3] == "0.900 / 0.100"
