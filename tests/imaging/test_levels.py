"""Order statistics; dark images made bright enough."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.imaging.color import MIN_GAMMA, Exposure, brighten
from roadtorch.imaging.levels import order_statistic
from roadtorch.road.seed_area import lower_quartile
from tests.draws import random

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


# --- exposure ---------------------------------------------------------------------------


@pytest.mark.parametrize("grey", [0.1, 0.2, 0.35])
def test_the_lower_part_of_a_dark_image_reaches_the_level(grey: float) -> None:
    image = torch.full((3, 20, 30), grey)
    image[:, :11] = 0.9  # the sky: rows above 0.55 of the height do not count

    bright = brighten(image, Exposure(ground=0.4))

    assert float(bright.mean(0)[11:].median()) == pytest.approx(0.4, abs=1e-4)


@pytest.mark.parametrize("dark", [0.02, 0.1, 0.3, 0.6])
def test_brightening_keeps_the_order_of_values_and_the_range(dark: float) -> None:
    image = random(3, 24, 32) * dark
    image[:, 0, 0], image[:, 0, 1] = 0.0, 1.0

    bright = brighten(image, Exposure())

    order = image.reshape(-1).argsort(stable=True)
    assert (bright.reshape(-1)[order].diff() >= 0).all()
    assert (bright >= image).all()
    assert bright.max() <= 1
    assert bright[:, 0, 1].tolist() == [1, 1, 1]


@pytest.mark.parametrize(("grey", "bright"), [(0.01, 0.01**MIN_GAMMA), (0.0, 0.0)])
def test_the_exponent_has_a_floor_and_black_stays_black(grey: float, bright: float) -> None:
    found = brighten(torch.full((3, 16, 40), grey), Exposure(ground=0.9))

    assert found.unique().numel() == 1
    assert float(found[0, 0, 0]) == pytest.approx(bright, rel=1e-5, abs=0.1 * (grey == 0))
