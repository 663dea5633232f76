"""Seed area, priors, squares and isolated regions."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.geometry import (
    SeedArea,
    prior_rows,
    prior_triangle,
    prior_uniform,
    remove_isolated,
    seed_area,
    squares,
)

SIDES = st.integers(16, 2000)


def test_the_default_seed_area_is_that_of_the_paper():
    assert seed_area(240, 320) == (slice(210, 240), slice(120, 200))


def test_the_seed_area_scales_with_the_image():
    assert seed_area(720, 960) == (slice(630, 720), slice(360, 600))


@given(SIDES, SIDES, st.integers(1, 240), st.integers(1, 320))
def test_the_seed_area_is_inside_not_empty_central_and_at_the_bottom(height, width, tall, wide):
    rows, columns = seed_area(height, width, SeedArea(height=tall, width=wide))

    assert 0 <= rows.start < rows.stop == height
    assert 0 <= columns.start < columns.stop <= width
    left, right = columns.start, width - columns.stop
    assert 0 <= right - left <= 1


@pytest.mark.parametrize("prior", [prior_uniform, prior_rows, prior_triangle])
@pytest.mark.parametrize("size", [(16, 16), (17, 40), (360, 480), (33, 16)])
def test_priors_are_symmetric_likelihoods(prior, size):
    likelihood = prior(*size)

    assert likelihood.shape == size
    assert likelihood.dtype == torch.float32
    assert likelihood.min() >= 0
    assert likelihood.max() <= 1
    assert torch.equal(likelihood, likelihood.flip(1))


def test_the_uniform_prior_is_one_half():
    assert torch.equal(prior_uniform(2, 3), torch.full((2, 3), 0.5))


def test_the_row_prior_grows_evenly_from_top_to_bottom():
    assert prior_rows(4, 2)[:, 0].tolist() == [0.125, 0.375, 0.625, 0.875]


@given(SIDES.filter(lambda side: side < 400), SIDES.filter(lambda side: side < 400))
@settings(max_examples=30, deadline=None)
def test_the_triangle_covers_the_seed_area_and_no_sky(height, width):
    triangle = prior_triangle(height, width)

    assert triangle[seed_area(height, width)].min() == 1
    assert triangle[: int(0.45 * height)].max() == 0


def test_the_triangle_widens_downwards_until_it_fills_the_bottom():
    widths = prior_triangle(240, 320).sum(1)

    assert (widths.diff() >= 0).all()
    assert widths[-1] == 320


def test_squares_are_numbered_by_rows_and_cut_off_at_the_edges():
    assert squares(3, 5, 2).tolist() == [[0, 0, 1, 1, 2], [0, 0, 1, 1, 2], [3, 3, 4, 4, 5]]


@given(st.integers(1, 60), st.integers(1, 60), st.integers(1, 70))
def test_squares_partition_the_picture(height, width, size):
    labels = squares(height, width, size)

    counts = torch.bincount(labels.flatten())
    assert labels.dtype == torch.int64
    assert counts.min() >= 1
    assert counts.max() <= size * size
    assert len(counts) == -(-height // size) * -(-width // size)


def mask_of(*rows: str) -> torch.Tensor:
    return torch.tensor([[pixel == "#" for pixel in row] for row in rows])


BOTTOM = (slice(3, 4), slice(2, 4))


def test_only_regions_that_touch_the_seed_area_stay():
    mask = mask_of("##....", "....##", "..#..#", "..##..")

    kept = remove_isolated(mask, *BOTTOM)

    assert torch.equal(kept, mask_of("......", "......", "..#...", "..##.."))


def test_regions_that_meet_at_a_corner_only_are_two():
    mask = mask_of("......", "......", ".#....", "..#...")

    assert remove_isolated(mask, *BOTTOM).sum() == 1


def test_several_regions_may_touch_the_seed_area():
    mask = mask_of("......", "......", "......", "..#.##")
    wide = (slice(3, 4), slice(0, 6))

    assert torch.equal(remove_isolated(mask, *wide), mask)


@pytest.mark.parametrize("mask", [mask_of("##", "..", "#."), torch.zeros(3, 2, dtype=torch.bool)])
def test_without_a_region_at_the_seed_area_the_mask_stays_as_it_is(mask):
    assert torch.equal(remove_isolated(mask, slice(2, 3), slice(1, 2)), mask)


def test_the_mask_handed_in_is_not_changed():
    mask = mask_of("##....", "......", "......", "..##..")
    before = mask.clone()

    remove_isolated(mask, *BOTTOM)

    assert torch.equal(mask, before)
