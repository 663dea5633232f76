"""The study of corrections: pools that are apart from the test, and its table."""

from pathlib import Path

import pytest
import torch

from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.data.folder import FolderLabels
from train.study_corrections import (
    GAP,
    corrected,
    drive_curve,
    folder_curve,
    pooled_f,
    seconds_of,
    table,
)


def frames(count: int, step: int = 30) -> Dataset:
    items = tuple(
        Item(f"0006R0_f{number * step:05d}", Path("a.jpg"), Path("a.png"), "0006R0")
        for number in range(count)
    )
    return Dataset("camvid", Path(), "train", items, FolderLabels())


def test_what_is_corrected_of_a_drive_is_a_minute_away_from_the_test() -> None:
    curve = drive_curve(frames(101), "0006R0", GAP)

    last, first = (seconds_of(curve.pool[-1]), seconds_of(curve.test[0]))
    assert first - last >= GAP
    assert len(curve.pool) >= len(curve.test) >= 20


def test_of_a_folder_every_second_picture_may_be_corrected() -> None:
    curve = folder_curve(frames(7), "0006R0")
    assert not {one.name for one in curve.pool} & {one.name for one in curve.test}
    assert (len(curve.pool), len(curve.test)) == (4, 3)


def test_a_corrected_picture_says_road_not_road_and_void() -> None:
    class Told:
        def truth(self, item: Item) -> Truth:
            return Truth(torch.tensor([[True, False, False]]), torch.tensor([[True, True, False]]))

    item = Item("a", Path("a.png"), Path("a.png"))
    found = corrected(Dataset("told", Path(), "", (item,), Told()), item)
    assert found.road.tolist() == [[1, 0, 254]]
    assert found.confirmed


def test_the_table_has_gains_with_intervals() -> None:
    assert pooled_f(torch.tensor([[[8.0, 2.0, 2.0]]])).tolist() == pytest.approx([0.8])
    about = {"curve": "idd", "label": "", "rule": "random", "maxf": 0.9, "head": 0.9}
    before, after = [[8, 2, 2]] * 3, [[9, 1, 1]] * 3
    runs = [
        {**about, "n": 0, "draw": 0, "f": 0.8, "f_centre": 0.8, "counts_centre": before},
        {**about, "n": 5, "draw": 0, "f": 0.9, "f_centre": 0.9, "counts_centre": after},
    ]
    for one in runs:
        one["counts"] = one["counts_centre"]

    text = table(runs)

    assert text.splitlines()[-1].endswith("| +0.100 (+0.100 to +0.100) |")
