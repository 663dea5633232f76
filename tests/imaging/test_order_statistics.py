"""The k-th smallest value, against sorting."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.imaging.order_statistics import lower_quartile, order_statistic

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


def test_there_is_no_value_behind_the_last() -> None:
    with pytest.raises(ValueError, match="kth"):
        order_statistic(torch.zeros(3), 3)
