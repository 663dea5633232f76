"""The study of corrections: pools that are apart from the test, and its table."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.data.folder import FolderLabels
from train.corrections_table import draw_curves, gain_interval, pooled_f, table
from train.study_corrections import (
    GAP,
    STAGES,
    Study,
    corrected,
    drive_curve,
    folder_curve,
    seconds_of,
    wanted,
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


def run_of(rule: str, count: int, draw: int, counts: list[list[int]]) -> dict[str, Any]:
    """What one run leaves behind."""
    f = float(pooled_f(torch.tensor(counts, dtype=torch.float64)[None]))
    key = {"curve": "idd", "label": "", "rule": rule, "n": count, "draw": draw}
    return {**key, "maxf": 0.9, "head": 0.9, "f": f, "counts": counts}


def test_the_table_has_gains_with_intervals() -> None:
    assert pooled_f(torch.tensor([[[8.0, 2.0, 2.0]]])).tolist() == pytest.approx([0.8])
    before = run_of("random", 0, 0, [[8, 2, 2]] * 3)
    after = [run_of(rule, 5, 0, [[9, 1, 1]] * 3) for rule in ("random", "different")]

    rows = table([before, *after]).splitlines()

    assert rows[2] == "| idd |  | 0 | 1 | 0.900 | 0.900 | 0.800 |  |  |"
    assert rows[3].endswith("| +0.100 (+0.100 to +0.100) | +0.000 (+0.000 to +0.000) |")
    assert rows[4].endswith("| +0.100 (+0.100 to +0.100) |  |")


def test_the_interval_has_what_the_draws_add() -> None:
    before = [run_of("random", 0, 0, [[8, 2, 2]] * 3)]
    one, other = (run_of("random", 5, draw, [[8 + draw, 2, 2]] * 3) for draw in (0, 1))
    assert gain_interval(before, [one]) == pytest.approx((0, 0))
    low, high = gain_interval(before, [one, other])
    assert low == pytest.approx(0)
    assert high == pytest.approx(other["f"] - one["f"])


def test_the_figure_is_an_svg_with_a_line_a_curve() -> None:
    runs = [run_of("random", count, 0, [[8, 2, 2]]) for count in (0, 5)]
    drawn = draw_curves(runs)
    assert drawn.lstrip().startswith("<svg")
    assert "idd" in drawn


def test_runs_with_other_settings_do_not_count(tmp_path: Path) -> None:
    file, values = tmp_path / "runs.jsonl", {"kind": "pictures"}
    study = Study(tmp_path, file, values, "")
    assert study.done() == []
    lines = [{"n": 0, "made_with": study.mark}, {"n": 1, "made_with": "others"}, {"n": 2}]
    file.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    assert [one["n"] for one in study.done()] == [0]
    assert Study(tmp_path, file, {**values, "random_seed": 3}, "").mark == study.mark
    assert Study(tmp_path, file, {**values, "visits": 3}, "").mark != study.mark


def test_no_correction_comes_first_and_one_draw_of_all_before_the_next() -> None:
    runs = list(wanted(STAGES))
    first = [count for _, _, count, _ in runs].index(20)
    assert {count for _, _, count, _ in runs[:first]} == {0}
    assert len({run[0] for run in runs[:first]}) == 6
    own = [run for run in runs if run[:3] == ("idd", "different", 20)]
    assert [draw for *_, draw in own] == [*range(3), *range(5), *range(5)]
