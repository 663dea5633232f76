"""Location priors."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.road.fusion import prior_rows, prior_triangle, prior_uniform
from roadtorch.road.seed_area import seed_area

SIDES = st.integers(16, 2000)


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
