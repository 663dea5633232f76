"""The k-th smallest value, against sorting; Otsu's threshold: the best of all cuts."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.imaging.levels import BINS, order_statistic, otsu_threshold
from roadtorch.road.fusion import centred_odds
from roadtorch.road.seed_area import lower_quartile
from tests.reference import otsu as reference


@given(st.lists(st.integers(-3 * BINS, 5 * BINS), min_size=2, max_size=40))
def test_no_other_cut_parts_the_values_better(integers: list[int]) -> None:
    values = torch.tensor([*integers, -400, 700]) / 100

    found = float(otsu_threshold(values))

    seen = reference.binned(values.double().numpy(), BINS)
    best = reference.most_between(seen)
    assert reference.between_classes(seen, found) == pytest.approx(best, rel=1e-4)


@given(st.floats(-50, 50), st.floats(0.01, 50), st.integers(1, 99))
def test_two_values_are_parted_in_the_middle_however_rare_one_is(
    low: float, apart: float, many: int
) -> None:
    values = torch.tensor([low] * many + [low + apart] * (100 - many), dtype=torch.float64)

    found = float(otsu_threshold(values))

    assert found == pytest.approx(low + apart / 2, abs=apart / BINS)


@pytest.mark.parametrize("value", [-3.0, 0.0, 1e-30, 7.5])
def test_of_equal_values_it_is_their_value(value: float) -> None:
    found = otsu_threshold(torch.full((3, 4), value))

    assert found.shape == ()
    assert found == value


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf])
def test_of_values_that_are_not_finite_no_road_is_made(odd: float) -> None:
    assert not centred_odds(torch.tensor([0.0, 1.0, odd]), 0.0, 0.25).sum().isfinite()


levels = st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=60)


@given(levels, st.data())
def test_it_is_what_sorting_finds_in_that_place(values: list[float], data: st.DataObject) -> None:
    k = data.draw(st.integers(0, len(values) - 1))

    found = order_statistic(torch.tensor(values), k)

    assert found == sorted(torch.tensor(values).tolist())[k]


@given(levels)
def test_the_lower_quartile_is_that_of_torch(values: list[float]) -> None:
    found = lower_quartile(torch.tensor(values, dtype=torch.float64))

    wanted = float(torch.tensor(values, dtype=torch.float64).quantile(0.25))
    assert found == pytest.approx(wanted, rel=1e-9, abs=1e-9)
