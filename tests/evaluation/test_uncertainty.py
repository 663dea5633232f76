"""Intervals and paired differences: textbook cases, properties, and how often they are right."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.evaluation import metrics, uncertainty
from roadtorch.evaluation.metrics import Decisions
from roadtorch.evaluation.uncertainty import Figure, Replicated

SEED = 5


def weights(*sizes: int, replicates: int = 400, seed: int = SEED) -> list[Tensor]:
    return uncertainty.group_weights(sizes, torch.Generator().manual_seed(seed), replicates)


def mean_of(values: Tensor) -> Figure:
    """The mean over one group of images."""
    return lambda drawn: drawn[0].to(values.dtype) @ values / len(values)


def normal(count: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(count, generator=generator, dtype=torch.float64)


# --- draws ----------------------------------------------------------------------------------------


def test_weights_draw_every_image_once_on_average():
    drawn = uncertainty.bootstrap_weights(7, 4000, torch.Generator().manual_seed(0))

    assert (drawn.sum(1) == 7).all()
    assert drawn.to(torch.float64).mean(0).tolist() == pytest.approx([1.0] * 7, abs=0.06)


def test_images_are_drawn_inside_their_groups():
    drawn = weights(3, 11)

    assert [part.shape for part in drawn] == [(400, 3), (400, 11)]
    assert (drawn[0].sum(1) == 3).all()
    assert (drawn[1].sum(1) == 11).all()


def test_a_seed_gives_the_same_draws_again():
    assert torch.equal(weights(9)[0], weights(9)[0])
    assert not torch.equal(weights(9)[0], weights(9, seed=SEED + 1)[0])


# --- intervals ------------------------------------------------------------------------------------


def test_interval_of_a_mean_is_the_textbook_one():
    values = normal(200, seed=1)

    weights = uncertainty.group_weights([200], torch.Generator().manual_seed(2), 4000)
    low, high = uncertainty.interval(uncertainty.replicate(mean_of(values), weights))

    error = float(values.std()) / math.sqrt(200)
    assert low == pytest.approx(float(values.mean()) - 1.96 * error, abs=0.1 * error)
    assert high == pytest.approx(float(values.mean()) + 1.96 * error, abs=0.1 * error)


def test_a_replicated_figure_has_its_value_over_all_images():
    values = normal(30, seed=1)

    figure = uncertainty.replicate(mean_of(values), weights(30))

    assert figure.value == pytest.approx(float(values.mean()), abs=1e-12)
    assert figure.draws.shape == (400,)
    low, high = uncertainty.interval(figure)
    assert low < figure.value < high


def test_a_figure_pooled_from_counts_keeps_image_and_truth_together():
    # Images found whole or not at all: recall is the share of road in the found ones.
    found = Decisions(torch.tensor([10, 0, 30]), *torch.tensor([[0, 0, 0], [0, 20, 0], [0, 0, 0]]))

    def pooled_recall(drawn: list[Tensor]) -> Tensor:
        hits, missed = drawn[0] @ found.true_positive, drawn[0] @ found.false_negative
        return hits.to(torch.float64) / (hits + missed)

    figure = uncertainty.replicate(pooled_recall, weights(3))

    assert figure.value == float(metrics.recall(Decisions(*torch.tensor([40, 0, 20, 0]))))
    possible = {
        round((10 * a + 30 * c) / (10 * a + 20 * b + 30 * c), 9)
        for a in range(4)
        for b in range(4 - a)
        for c in [3 - a - b]
    }
    assert {round(value, 9) for value in figure.draws.tolist()} == possible


def test_draws_without_a_value_are_left_out():
    nothing = torch.full((5,), math.nan, dtype=torch.float64)
    some = torch.tensor([math.nan, 1, 1, math.nan, 1], dtype=torch.float64)

    assert all(math.isnan(end) for end in uncertainty.interval(Replicated(math.nan, nothing)))
    assert uncertainty.interval(Replicated(1.0, some)) == (1, 1)


def test_intervals_hold_the_true_mean_about_as_often_as_they_say():
    inside = 0
    for trial in range(300):
        figure = uncertainty.replicate(mean_of(3 + normal(40, seed=trial)), weights(40, seed=trial))
        low, high = uncertainty.interval(figure)
        inside += low < 3 < high

    assert 0.90 <= inside / 300 <= 0.98


# --- two detectors over the same images -----------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 40))
def test_against_itself_a_detector_differs_by_exactly_nothing(seed, images):
    figure = uncertainty.replicate(mean_of(normal(images, seed)), weights(images))

    same = uncertainty.difference(figure, figure)

    assert same.value == 0
    assert uncertainty.interval(same) == (0, 0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 40))
def test_turning_the_order_flips_the_sign(seed, images):
    drawn = weights(images)
    one, other = (
        uncertainty.replicate(mean_of(normal(images, seed + step)), drawn) for step in (0, 1)
    )

    there, back = uncertainty.difference(one, other), uncertainty.difference(other, one)

    assert there.value == -back.value
    low, high = uncertainty.interval(there)
    assert uncertainty.interval(back) == pytest.approx((-high, -low), abs=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 40))
def test_a_detector_better_on_every_image_is_better_under_every_draw(seed, images):
    base, gain = normal(images, seed), 0.01 + normal(images, seed + 1).abs()
    drawn = weights(images)
    one, other = (uncertainty.replicate(mean_of(v), drawn) for v in (base + gain, base))

    low, high = uncertainty.interval(uncertainty.difference(one, other))

    assert low > 0
    assert high >= low


def test_pairs_see_what_single_intervals_hide():
    # Images differ a lot, the two detectors by a little, on the same ones.
    images = 10 * normal(100, seed=1)
    drawn = weights(100)
    one = uncertainty.replicate(mean_of(images + 0.2 + 0.1 * normal(100, seed=2)), drawn)
    other = uncertainty.replicate(mean_of(images), drawn)

    assert uncertainty.interval(one)[0] < uncertainty.interval(other)[1]  # they overlap
    assert uncertainty.interval(uncertainty.difference(one, other))[0] > 0.1


def test_equal_detectors_are_called_different_about_as_rarely_as_promised():
    called = 0
    for trial in range(300):
        drawn = weights(40, seed=trial)
        one, other = (
            uncertainty.replicate(mean_of(normal(40, seed=2 * trial + step)), drawn)
            for step in (0, 1)
        )
        low, high = uncertainty.interval(uncertainty.difference(one, other))
        called += not low < 0 < high

    assert 0.02 <= called / 300 <= 0.10


def test_draws_of_different_lengths_are_refused():
    values = normal(8, seed=0)
    one, other = (
        uncertainty.replicate(mean_of(values), weights(8, replicates=many)) for many in (10, 20)
    )

    with pytest.raises(ValueError, match="10 draws cannot be compared with 20"):
        uncertainty.difference(one, other)
