"""Outlines that follow the picture, and thin holes in the road."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.imaging.resize import WorkingSize, at_work, resized, size_of
from roadtorch.road.ego import continued
from roadtorch.road.outlines import BARELY, filled, followed, outlined


def halves(height: int, width: int) -> Tensor:
    """Two colours and a slanted line between: (3,H,W)."""
    row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    side = (column / width + 0.3 * row / height > 0.6).float()
    colour = torch.tensor([0.3, 0.1, -0.2])[:, None, None]
    return (0.4 + colour * side).clamp(0, 1)


def test_stairs_become_the_line_that_the_picture_has() -> None:
    image, small = halves(480, 640), resized(halves(480, 640), (180, 240))
    road = image[0] > 0.5
    stairs = small[0, 6::12, 6::12].repeat_interleave(12, 0).repeat_interleave(12, 1)
    likelihood = 0.1 + 0.8 * (stairs > 0.5)

    wrong = (resized(likelihood, (480, 640)) > 0.5) != road
    still = (followed(likelihood, small, image) > 0.5) != road

    assert still.sum() < wrong.sum() / 10


def test_what_is_an_affine_function_of_colour_stays_itself() -> None:
    image = resized(torch.rand(3, 15, 20, generator=torch.Generator().manual_seed(0)), (120, 160))
    function = 0.2 + 0.3 * image[0] + 0.4 * image[2]

    found = followed(function, image, image)

    assert (found - function).abs().max() < 0.06  # the ridge flattens it a little


@given(st.integers(16, 70), st.integers(16, 70), st.floats(0, 1), st.integers(0, 99))
def test_what_says_the_same_everywhere_says_it_in_any_picture(height, width, value, seed):
    image = torch.rand(3, height, width, generator=torch.Generator().manual_seed(seed))

    found = followed(torch.full((height, width), value), image, image)

    assert found.shape == (height, width)
    assert 0 <= float(found.min()) <= float(found.max()) <= 1
    np.testing.assert_allclose(found, torch.full_like(found, value), atol=1e-3, rtol=0.0)


def test_what_the_ego_car_map_leaves_of_a_bonnet_like_the_road_stays_no_road() -> None:
    working, begins, missed = WorkingSize(pixels=256 * 192), 400, 4
    noise = torch.randn(3, 480, 640, generator=torch.Generator().manual_seed(0))
    level = torch.where(torch.arange(480)[:, None] < begins, 0.5, 0.4)
    image = (level + 0.04 * noise).clamp(0, 1)
    small = at_work(image, working)
    below = (torch.arange(len(small[0]))[:, None] + 0.5) * 480 / len(small[0]) - begins
    below = below.expand(size_of(small))
    ego = below > missed
    likelihood = continued(0.9 - 0.8 * (below / 12 + 0.5).clamp(0, 1), ego)

    found = outlined({"likelihood": likelihood, "ego": ego}, small, image, working, 0.5)

    assert (found[begins : begins + missed] > 0.5).double().mean() < 0.05
    assert (found[: begins - 12] > 0.5).double().mean() > 0.99


ROAD, NOT = 0.8, 0.1


@pytest.mark.parametrize(
    ("hole", "is_filled"),
    [
        ((slice(60, 110), slice(80, 83)), True),  # a line
        ((slice(60, 110), slice(80, 130)), False),  # a car
        ((slice(100, 120), slice(80, 83)), True),  # a line that leaves the picture
        ((slice(20, 110), slice(80, 83)), False),  # what is thin and joins the background
    ],
)
def test_thin_holes_are_road_by_one_byte_level(hole: tuple[slice, slice], is_filled: bool) -> None:
    likelihood = torch.full((120, 320), NOT)
    likelihood[40:] = ROAD
    likelihood[hole] = NOT
    expected = likelihood.clone()
    expected[hole] = 0.5 + BARELY if is_filled else NOT

    assert torch.equal(filled(likelihood, 0.5), expected)
