"""Choosing how far to trust corrected weights: what is near an outline, and the rows."""

import torch

from train.choose_corrections import CENTRES, DETAILS, Tried, at_outline, row


def test_near_an_outline_are_both_its_sides() -> None:
    road = torch.zeros(5, 9, dtype=torch.bool)
    road[:, 5:] = True
    assert at_outline(road, 1)[2].nonzero()[:, 0].tolist() == [4, 5]
    assert at_outline(road, 2)[2].nonzero()[:, 0].tolist() == [3, 4, 5, 6]
    assert not at_outline(torch.ones_like(road), 2).any()


def test_a_row_has_first_all_details_as_they_ship() -> None:
    found = [Tried(detail, one, 0.9, detail / 10) for detail in DETAILS for one in CENTRES]
    cells = row("a", 5, found).split(" | ")
    assert len(cells) == 2 + 2 * len(DETAILS)
    assert cells[2] == "0.900 / 0.050"
    assert cells[3] == "0.900 / 0.100"
