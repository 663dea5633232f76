"""What further training changed: its means, and the pictures that are chosen to be looked at."""

import math
from pathlib import Path

import pytest

from roadtorch.data.dataset import LabelledItem
from roadtorch.evaluation.disagreement import Disagreement, Disagreements, most_and_spread
from roadtorch.evaluation.report.adaptation import Adaptation, summary_table
from tests.reports import made_contender, scored


def change(number: int, differs: float, before: float = 0.5, after: float = 0.6) -> Disagreement:
    item = LabelledItem(f"picture_{number:02d}", Path("x.png"), Path("x.png"))
    return Disagreement(item, differs, 0.3, 0.3 + differs, before, after)


def numbers(found: list[Disagreement]) -> list[int]:
    return [int(one.item.name[-2:]) for one in found]


def test_half_changed_most_and_the_others_are_spread_down_to_the_least() -> None:
    ranked = [change(number, number / 100) for number in reversed(range(25))]

    chosen = most_and_spread(ranked, 10)

    # 24 to 20 changed most; of the twenty others every fourth, the least changed included.
    assert numbers(chosen) == [24, 23, 22, 21, 20, 16, 12, 8, 4, 0]


@pytest.mark.parametrize("count", [1, 2, 3, 7, 10, 11])
@pytest.mark.parametrize("pictures", [1, 2, 7, 10, 11, 12])
def test_no_picture_is_chosen_twice_and_none_is_missing(pictures: int, count: int) -> None:
    ranked = [change(number, number / 100) for number in reversed(range(pictures))]
    chosen = numbers(most_and_spread(ranked, count))
    assert len(chosen) == len(set(chosen)) == min(pictures, count)
    assert chosen[0] == pictures - 1


def test_the_means_leave_out_pictures_without_trust() -> None:
    found = [change(0, 0.1, 0.5, 0.7), change(1, 0.3, 0.6, 0.3), change(2, 0.2, math.nan, math.nan)]

    both = made_contender("before"), made_contender("after")
    seen = Disagreements(scored({"it": None}).dataset, both, found, [])
    table = summary_table(Adaptation(seen, (Path("a"), Path("b")), found, None, []))

    minus = "\N{MINUS SIGN}"
    rows = {name: [(cell.text, cell.note) for cell in cells] for name, cells in table.rows()}
    assert rows == {
        "share of road": [("30.0 %", ""), ("50.0 %", ""), ("+20.0 points", "")],
        "trust": [
            ("0.550", ""), ("0.500", ""), (f"{minus}0.050", "rose on 1, fell on 1 pictures")
        ],
    }  # fmt: skip
