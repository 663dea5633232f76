"""The ego car by its potential: what goes down to the lower edge, without a hole."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.road.ego import LEAST_FREE, SOLID, ego_found

HEIGHT, WIDTH = 40, 60


def potential(*parts: tuple[slice, slice]) -> torch.Tensor:
    """0.9 in the given rows and columns, 0.1 elsewhere."""
    found = torch.full((HEIGHT, WIDTH), 0.1)
    for rows, columns in parts:
        found[rows, columns] = 0.9
    return found


EVERY = slice(None)
BONNET = (slice(30, None), EVERY)


def test_what_goes_down_to_the_lower_edge_is_the_ego_car() -> None:
    assert torch.equal(ego_found(potential(BONNET)), potential(BONNET) > 0.5)


def test_light_on_the_bonnet_leaves_no_hole() -> None:
    lit = potential(BONNET)
    lit[33:36, 20:30] = 0.2

    assert torch.equal(ego_found(lit), potential(BONNET) > 0.5)


def test_a_car_ahead_is_none_and_takes_nothing_from_the_bonnet() -> None:
    ahead = (slice(14, 18), slice(25, 35))

    assert not ego_found(potential(ahead)).any()
    # From the car's upper edge down, 14 of 26 rows are likelier ego car than not.
    assert torch.equal(ego_found(potential(ahead, BONNET)), potential(BONNET) > 0.5)


def test_a_car_at_one_side_is_found_in_its_columns_alone() -> None:
    side = potential((slice(20, None), slice(0, 15)))

    assert torch.equal(ego_found(side), side > 0.5)


@pytest.mark.parametrize("rows", [HEIGHT, round(HEIGHT * (1 - LEAST_FREE)) + 1])
def test_where_nearly_all_is_ego_car_there_is_none(rows: int) -> None:
    assert not ego_found(potential((slice(HEIGHT - rows, None), EVERY))).any()


@pytest.mark.parametrize(("believed", "is_one"), [(0.55, False), (0.85, True)])
def test_what_is_half_believed_is_no_ego_car(believed: float, is_one: bool) -> None:
    found = ego_found(torch.where(potential(BONNET) > 0.5, believed, 0.1))

    assert bool(found.any()) == is_one


@pytest.mark.parametrize(("rows", "is_one"), [(3, True), (HEIGHT // 2, False)])
def test_the_larger_the_surer_it_has_to_be(rows: int, is_one: bool) -> None:
    found = ego_found(potential((slice(HEIGHT - rows, None), EVERY)) * 0.75)

    assert bool(found.any()) == is_one


def test_one_half_is_not_likelier_than_not() -> None:
    assert not ego_found(torch.full((HEIGHT, WIDTH), 0.5)).any()


@given(st.integers(0, 2**31), st.floats(0.1, 0.9))
def test_each_column_is_free_above_and_ego_car_below_and_solid_where_it_begins(
    seed: int, level: float
) -> None:
    at = torch.Generator().manual_seed(seed)
    rough = torch.rand(12, 16, generator=at) + (torch.arange(12)[:, None] / 12 - 0.5) * level

    car = ego_found(rough.clamp(0, 1))

    assert (car.int().diff(dim=0) >= 0).all()
    for column in car.any(0).nonzero()[:, 0].tolist():
        first = int(car[:, column].int().argmax())
        assert rough[first, column] > 0.5
        assert (rough[first:, column] > 0.5).float().mean() >= SOLID
