"""Measures of trust, and disagreement of detectors."""

import math
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import spearmanr
from sklearn.metrics import roc_auc_score

from roadtorch.data.dataset import LabelledItem
from roadtorch.evaluation import trust_measures
from roadtorch.evaluation.disagreement import Disagreement, Disagreements, select_changed
from roadtorch.evaluation.report.adaptation import summary_table
from roadtorch.evaluation.trust_measures import TrustSamples
from tests.reports import make_contender, make_scored_run

TENTHS = st.integers(0, 10).map(lambda tenths: tenths / 10)  # few values: many are equal


def images(most: int):
    return st.lists(st.tuples(TENTHS, TENTHS), min_size=1, max_size=most)


def columns(pairs: list[tuple[float, float]]) -> tuple[torch.Tensor, torch.Tensor]:
    trusts, f = torch.tensor(pairs, dtype=torch.float64).unbind(1)
    return trusts, f


@settings(deadline=None, max_examples=40)
@given(images(30))
def test_ranks_and_areas_equal_those_of_scipy_and_scikit_learn(pairs):
    trusts, f = columns(pairs)
    bad = f < 0.6

    if trusts.unique().numel() > 1 and f.unique().numel() > 1:
        expected = spearmanr(trusts, f)[0]
        assert trust_measures.rank_correlation(trusts, f) == pytest.approx(expected, abs=1e-9)
    if 0 < bad.sum() < len(bad):
        expected = float(roc_auc_score(bad, -trusts))
        assert trust_measures.failure_auc(trusts, f) == pytest.approx(expected, abs=1e-12)


def test_within_groups_what_differs_between_them_counts_for_nothing():
    # In each group trust has the wrong order; the groups' levels give the right one over all.
    trusts = torch.tensor([0.1, 0.2, 0.3, 0.4, 0.6, 0.7, 0.8, 0.9], dtype=torch.float64)
    f = torch.tensor([0.4, 0.3, 0.2, 0.1, 0.9, 0.8, 0.7, 0.6], dtype=torch.float64)
    samples = TrustSamples(trusts, f, ["a"] * 4 + ["b"] * 4)

    assert trust_measures.rank_correlation(samples.trust, samples.f) > 0.5
    assert trust_measures.mean_group_correlation(samples) == pytest.approx(-1)


def test_a_group_of_three_has_no_correlation_of_its_own():
    f = torch.tensor([0.1, 0.2, 0.3, 0.4, 0.9, 0.8, 0.7])
    groups = ["a"] * 4 + ["b"] * 3

    correlation = trust_measures.mean_group_correlation(TrustSamples(f.sort().values, f, groups))

    assert correlation == pytest.approx(1)
    assert math.isnan(trust_measures.mean_group_correlation(TrustSamples(f[4:], f[4:], groups[4:])))


def test_constant_values_are_nan():
    constant, f = torch.full((5,), 0.5), torch.linspace(0.1, 0.5, 5)
    nothing = torch.zeros(0)

    for pair in ((constant, f), (nothing, nothing)):
        assert math.isnan(trust_measures.rank_correlation(*pair))
        assert math.isnan(trust_measures.failure_auc(*pair))


# --- disagreement -----------------------------------------------------------------------


def change(
    number: int, differs: float, trust_before: float = 0.5, trust_after: float = 0.6
) -> Disagreement:
    item = LabelledItem(f"image_{number:02d}", Path("x.png"), Path("x.png"))
    return Disagreement(item, differs, 0.3, 0.3 + differs, trust_before, trust_after)


def numbers(ranked: list[Disagreement]) -> list[int]:
    return [int(pair.item.name[-2:]) for pair in ranked]


def test_half_changed_most_and_the_others_are_spread_down_to_the_least() -> None:
    ranked = [change(number, number / 100) for number in reversed(range(25))]

    chosen = select_changed(ranked, 10)

    # 24 to 20 changed most; of the twenty others every fourth, the least changed included.
    assert numbers(chosen) == [24, 23, 22, 21, 20, 16, 12, 8, 4, 0]


@pytest.mark.parametrize("count", [1, 2, 3, 7, 10, 11])
@pytest.mark.parametrize("images", [1, 2, 7, 10, 11, 12])
def test_no_image_is_chosen_twice_and_none_is_missing(images: int, count: int) -> None:
    ranked = [change(number, number / 100) for number in reversed(range(images))]
    chosen = numbers(select_changed(ranked, count))
    assert len(chosen) == len(set(chosen)) == min(images, count)
    assert chosen[0] == images - 1


def test_the_means_leave_out_images_without_trust() -> None:
    changes = [
        change(0, 0.1, 0.5, 0.7),
        change(1, 0.3, 0.6, 0.3),
        change(2, 0.2, math.nan, math.nan),
    ]

    methods = make_contender("before"), make_contender("after")
    comparison = Disagreements(make_scored_run({"it": None}).dataset, methods, changes, [])
    table = summary_table(comparison)

    minus = "\N{MINUS SIGN}"
    rows = {name: [(cell.text, cell.note) for cell in cells] for name, cells in table.rows()}
    assert rows == {
        "fraction of road": [("0.300", ""), ("0.500", ""), ("+0.200", "")],
        "trust": [
            ("0.550", ""), ("0.500", ""), (f"{minus}0.050", "rose on 1, fell on 1 images")
        ],
    }  # fmt: skip
