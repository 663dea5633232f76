"""Two checkouts in turn: each loads its own package, and ratios are those of the rounds."""

import sys
from pathlib import Path

from roadtorch.superpixels import slic as superpixels
from scripts import bench, bench_against

CHECKOUT = Path(__file__).resolve().parents[2]


def test_a_checkout_has_its_own_package_and_others_stay_loaded() -> None:
    before = dict(sys.modules)

    found = bench_against.checkout_of(CHECKOUT)

    assert found.bench is not bench
    assert found.slic is not superpixels.slic
    assert sys.modules["scripts.bench"] is before["scripts.bench"]
    assert sys.modules["roadtorch"] is before["roadtorch"]


def test_a_ratio_is_the_median_of_the_rounds_ratios() -> None:
    rounds = [[{"road": 2.0}, {"road": 1.0}], [{"road": 4.0}, {"road": 3.0}]]

    found = bench_against.figures_of(rounds, ["a1", "b2"], "1 thread")

    columns = ("before, ms, 1 thread", "now, ms, 1 thread", "ratio, 1 thread")
    told = {one["name"].removeprefix("before-after/"): one["value"] for one in found}
    assert [told[f"road/{column}"] for column in columns] == [3.0, 2.0, 0.625]
    assert [told[f"commit/{column}"] for column in columns[:2]] == ["a1", "b2"]
