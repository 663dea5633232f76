"""Calibration against brute force on pixels and scikit-learn."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.calibration import calibration_curve
from sklearn.metrics import brier_score_loss

from roadtorch.evaluation import curves
from roadtorch.evaluation.metrics import RoadCounts
from tests.evaluation.conftest import count, stack
from tests.reference import calibration as slow


def drawn(seed: int, levels: int = 256) -> tuple[np.ndarray, np.ndarray]:
    """Scores that lie exactly on levels, road more likely where they are high."""
    generator = np.random.default_rng(seed)
    scores = generator.integers(0, levels, 500) / (levels - 1)
    return scores, generator.random(500) < scores**2


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_brier_score_equals_pixels_and_scikit_learn(seed):
    scores, road = drawn(seed)

    found = float(curves.brier(count(scores, road, 256)))

    assert found == pytest.approx(slow.brier(scores, road), abs=1e-12)
    assert found == pytest.approx(brier_score_loss(road, scores), abs=1e-12)


@pytest.mark.parametrize("bins", [1, 7, 20])
@pytest.mark.parametrize("seed", range(3))
def test_reliability_equals_pixels_and_scikit_learn(seed, bins):
    scores, road = drawn(seed)

    curve = curves.reliability(count(scores, road, 256), bins)

    expected = np.array(slow.reliability(scores, road, bins))
    observed, predicted = calibration_curve(road, scores, n_bins=bins)
    filled = curve.share > 0
    for found, column in zip(
        (curve.predicted, curve.observed, curve.share), expected.T, strict=True
    ):
        assert found.tolist() == pytest.approx(column.tolist(), abs=1e-12, nan_ok=True)
    assert curve.predicted[filled].tolist() == pytest.approx(predicted.tolist(), abs=1e-12)
    assert curve.observed[filled].tolist() == pytest.approx(observed.tolist(), abs=1e-12)


def test_a_likelihood_on_an_edge_belongs_to_the_lower_bin():
    curve = curves.reliability(count([0.0, 0.5, 0.5, 1.0], [0, 1, 0, 1], levels=3), bins=2)

    assert curve.share.tolist() == [0.75, 0.25]
    assert curve.predicted.tolist() == pytest.approx([1 / 3, 1])
    assert curve.observed.tolist() == pytest.approx([1 / 3, 1])


def test_expected_error_is_the_mean_gap_over_pixels():
    scores, road = drawn(4)

    found = float(curves.expected_error(count(scores, road, 256), bins=10))

    rows = slow.reliability(scores, road, 10)
    assert found == pytest.approx(sum(s * abs(o - p) for p, o, s in rows if s), abs=1e-12)


def test_leading_dimensions_and_sums():
    one, two = count(*drawn(1), 256), count(*drawn(2), 256)
    both = stack(one, two)

    assert curves.brier(both).tolist() == [
        float(curves.brier(one)),
        float(curves.brier(two)),
    ]
    assert torch.equal(curves.reliability(both).observed[1], curves.reliability(two).observed)
    together = np.concatenate([drawn(1), drawn(2)], axis=1)
    assert float(curves.brier(one + two)) == pytest.approx(
        slow.brier(together[0], together[1]), abs=1e-12
    )


def test_nothing_counted_is_nan():
    nothing = RoadCounts(torch.zeros(256, dtype=torch.int64), torch.zeros(256, dtype=torch.int64))

    assert math.isnan(curves.brier(nothing))
    assert math.isnan(curves.expected_error(nothing))
