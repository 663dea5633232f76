"""Measures of trust against pairs, orders and SciPy."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import spearmanr
from sklearn.metrics import roc_auc_score

from roadtorch.evaluation import trust
from roadtorch.evaluation.trust import Trusted
from tests.reference import trust as slow

TENTHS = st.integers(0, 10).map(lambda tenths: tenths / 10)  # few values: many are equal


def pictures(most: int):
    return st.lists(st.tuples(TENTHS, TENTHS), min_size=1, max_size=most)


def columns(pairs: list[tuple[float, float]]) -> tuple[torch.Tensor, torch.Tensor]:
    trusts, f = torch.tensor(pairs, dtype=torch.float64).unbind(1)
    return trusts, f


@settings(deadline=None, max_examples=40)
@given(pictures(30))
def test_ranks_and_areas_equal_those_of_scipy_and_scikit_learn(pairs):
    trusts, f = columns(pairs)
    bad = f < 0.6

    if trusts.unique().numel() > 1 and f.unique().numel() > 1:
        expected = spearmanr(trusts, f)[0]
        assert trust.rank_correlation(trusts, f) == pytest.approx(expected, abs=1e-9)
    if 0 < bad.sum() < len(bad):
        expected = float(roc_auc_score(bad, -trusts))
        assert trust.failure_auc(trusts, f, 0.6) == pytest.approx(expected, abs=1e-12)


@settings(deadline=None, max_examples=20)
@given(pictures(6))
def test_the_risk_of_equals_is_the_mean_over_their_orders(pairs):
    trusts, f = columns(pairs)

    curve = trust.risk_coverage(trusts, f)

    risks = slow.risks(trusts.tolist(), f.tolist())
    assert curve.y.tolist() == pytest.approx(risks, abs=1e-9)
    assert trust.risk_area(curve) == pytest.approx(sum(risks) / len(risks), abs=1e-9)
    assert curve.x.tolist() == pytest.approx([(k + 1) / len(f) for k in range(len(f))])


def test_within_groups_what_differs_between_them_counts_for_nothing():
    # In each group trust has the wrong order; the groups' levels give the right one over all.
    trusts = torch.tensor([0.1, 0.2, 0.3, 0.4, 0.6, 0.7, 0.8, 0.9], dtype=torch.float64)
    f = torch.tensor([0.4, 0.3, 0.2, 0.1, 0.9, 0.8, 0.7, 0.6], dtype=torch.float64)
    both = Trusted(trusts, f, ["a"] * 4 + ["b"] * 4)

    assert trust.rank_correlation(both.trust, both.f) > 0.5
    assert trust.correlation_within(both) == pytest.approx(-1)


def test_a_group_of_three_has_no_correlation_of_its_own():
    f = torch.tensor([0.1, 0.2, 0.3, 0.4, 0.9, 0.8, 0.7])
    groups = ["a"] * 4 + ["b"] * 3

    found = trust.correlation_within(Trusted(f.sort().values, f, groups))

    assert found == pytest.approx(1)
    assert math.isnan(trust.correlation_within(Trusted(f[4:], f[4:], groups[4:])))


def test_nothing_to_tell_apart_is_nan():
    same, f = torch.full((5,), 0.5), torch.linspace(0.1, 0.5, 5)
    nothing = torch.zeros(0)

    for pair in ((same, f), (nothing, nothing)):
        assert math.isnan(trust.rank_correlation(*pair))
        assert math.isnan(trust.failure_auc(*pair, 0.6))
    assert math.isnan(trust.risk_area(trust.risk_coverage(nothing, nothing)))
