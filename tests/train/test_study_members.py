"""The study of members: what is joined how, and that a drive has no part in its own choice."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from roadtorch.data.dataset import Item, Truth
from roadtorch.evaluation import metrics
from train.study_members import Joined, Picture, best_choice, drive_counts, held_out_choices

DRIVES = ["0001TP", "0006R0", "0016E5"]


def picture(drive: str, road: Tensor, **maps: Tensor) -> Picture:
    item = Item(drive, Path(f"{drive}.png"), Path(f"{drive}.png"), drive)
    return Picture(item, Truth(road, torch.ones_like(road)), maps)


def test_odds_are_multiplied_and_the_members_weighted() -> None:
    base, member = torch.tensor([[0.2, 0.7]]), torch.tensor([[0.9, 0.5]])
    seen = picture("0001TP", base > 0.5, base=base, member=member)

    found = Joined("base", "member", 0.5).likelihood(seen)

    odds = base / (1 - base) * (member / (1 - member)).sqrt()
    torch.testing.assert_close(found, odds / (1 + odds))
    torch.testing.assert_close(Joined("base", "member", 0.0).likelihood(seen), base)


def test_a_drive_has_no_part_in_what_is_chosen_for_it() -> None:
    generator = torch.Generator().manual_seed(0)
    pictures = []
    for drive in DRIVES:
        road = torch.rand(20, 20, generator=generator) > 0.5
        blind = torch.full((20, 20), 0.5)
        sure = torch.where(road, 0.9, 0.1)
        # Only on the last drive does the liar tell the truth, and there the other one does not.
        honest, liar = (1 - sure, sure) if drive == DRIVES[2] else (sure, 1 - sure)
        pictures.append(picture(drive, road, base=blind, honest=honest, liar=liar))
    counts = dict(drive_counts(pictures, "base", "honest"))
    counts |= drive_counts(pictures, "base", "liar")

    found = held_out_choices(counts, DRIVES)

    assert found[DRIVES[2]].member == "honest"
    assert found[DRIVES[2]].weight > 0
    assert best_choice(counts, DRIVES[2:]).member == "liar"
    right, _ = metrics.max_f(counts[found[DRIVES[2]]][DRIVES[0]])
    assert float(right) == pytest.approx(1)
