"""Intervals and paired differences: textbook cases, properties, and how often they are right."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.evaluation import uncertainty
from roadtorch.evaluation.uncertainty import Replicated

SEED = 5


def weights(size: int, replicates: int = 400, seed: int = SEED) -> Tensor:
    return uncertainty.bootstrap_weights(size, torch.Generator().manual_seed(seed), replicates)


def mean_of(values: Tensor, drawn: Tensor) -> Replicated:
    """The mean over images, and over every draw of them."""
    return Replicated(float(values.mean()), drawn.to(values.dtype) @ values / len(values))


def normal(count: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(count, generator=generator, dtype=torch.float64)


# --- draws ----------------------------------------------------------------------------------------


def test_weights_draw_every_image_once_on_average():
    drawn = weights(7, 4000)

    assert (drawn.sum(1) == 7).all()
    assert drawn.to(torch.float64).mean(0).tolist() == pytest.approx([1.0] * 7, abs=0.06)


# --- intervals ------------------------------------------------------------------------------------


def test_interval_of_a_mean_is_the_textbook_one():
    values = normal(200, seed=1)

    low, high = uncertainty.interval(mean_of(values, weights(200, 4000, seed=2)))

    error = float(values.std()) / math.sqrt(200)
    assert low == pytest.approx(float(values.mean()) - 1.96 * error, abs=0.1 * error)
    assert high == pytest.approx(float(values.mean()) + 1.96 * error, abs=0.1 * error)


def test_draws_without_a_value_are_left_out():
    nothing = torch.full((5,), math.nan, dtype=torch.float64)
    some = torch.tensor([math.nan, 1, 1, math.nan, 1], dtype=torch.float64)

    assert all(math.isnan(end) for end in uncertainty.interval(Replicated(math.nan, nothing)))
    assert uncertainty.interval(Replicated(1.0, some)) == (1, 1)


def test_intervals_hold_the_true_mean_about_as_often_as_they_say():
    inside = 0
    for trial in range(300):
        figure = mean_of(3 + normal(40, seed=trial), weights(40, seed=trial))
        low, high = uncertainty.interval(figure)
        inside += low < 3 < high

    assert 0.90 <= inside / 300 <= 0.98


# --- two detectors over the same images -----------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 40))
def test_pairs_are_signed_and_what_is_better_on_every_image_is_so_under_every_draw(seed, images):
    base, gain = normal(images, seed), 0.01 + normal(images, seed + 1).abs()
    drawn = weights(images)
    one, other = (mean_of(values, drawn) for values in (base + gain, base))

    low, high = uncertainty.interval(uncertainty.difference(one, other))
    back = uncertainty.interval(uncertainty.difference(other, one))

    assert 0 < low <= high
    assert back == pytest.approx((-high, -low), abs=1e-12)
    assert uncertainty.interval(uncertainty.difference(one, one)) == (0, 0)


def test_equal_detectors_are_called_different_about_as_rarely_as_promised():
    called = 0
    for trial in range(300):
        drawn = weights(40, seed=trial)
        one, other = (mean_of(normal(40, seed=2 * trial + step), drawn) for step in (0, 1))
        low, high = uncertainty.interval(uncertainty.difference(one, other))
        called += not low < 0 < high

    assert 0.02 <= called / 300 <= 0.10


def test_draws_of_different_lengths_are_refused():
    values = normal(8, seed=0)
    one, other = (mean_of(values, weights(8, many)) for many in (10, 20))

    with pytest.raises(ValueError, match="10 draws cannot be compared with 20"):
        uncertainty.difference(one, other)
