"""The k-th smallest value, against sorting."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.order_statistics import order_statistic

levels = st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=60)


@given(levels, st.data())
def test_it_is_what_sorting_finds_in_that_place(values: list[float], data: st.DataObject) -> None:
    k = data.draw(st.integers(0, len(values) - 1))

    found = order_statistic(torch.tensor(values), k)

    assert found == sorted(torch.tensor(values).tolist())[k]


def test_there_is_no_value_behind_the_last() -> None:
    with pytest.raises(ValueError, match="kth"):
        order_statistic(torch.zeros(3), 3)
