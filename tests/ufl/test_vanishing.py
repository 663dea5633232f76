"""Gabor filters, the vote for the vanishing point, and the borders from it."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.ufl import vanishing
from tests.draws import random

SIZE = (90, 120)
POINT = torch.tensor([25.0, 60.0])
AIMING = vanishing.pixel_angles(POINT, SIZE).remainder(180)  # all texture aims at the point


# --- which way texture runs -------------------------------------------------------------


@pytest.mark.parametrize("angle", [0, 20, 90, 130])
def test_stripes_have_their_orientation(angle: int) -> None:
    row, column = np.indices((48, 48))
    across = row * math.cos(math.radians(angle)) - column * math.sin(math.radians(angle))
    stripes = torch.from_numpy(0.5 + 0.5 * np.cos(2 * math.pi * across / 6)).float()

    orientation, sure = vanishing.dominant_orientation(
        vanishing.gabor_responses(stripes, vanishing.GaborBank())
    )

    assert (vanishing.angle_between(orientation[16:32, 16:32], torch.tensor(angle)) <= 5).all()
    assert sure.shape == (48, 48)


def test_the_spectrum_is_that_of_the_filter_as_it_is_written() -> None:
    # Kong et al., pixel by pixel, and its discrete Fourier transform.
    size, angle, frequency = 96, 30.0, 0.7
    y, x = np.indices((size, size)) - size // 2
    turn = math.radians(angle)
    a, b = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    envelope = np.exp(-(frequency**2) * (4 * a**2 + b**2) / (8 * vanishing.ENVELOPE_WAVES**2))
    wave = np.exp(1j * frequency * a) - math.exp(-(vanishing.ENVELOPE_WAVES**2) / 2)
    filtered = frequency / (math.sqrt(2 * math.pi) * vanishing.ENVELOPE_WAVES) * envelope * wave

    expected = np.fft.fft2(np.fft.ifftshift(filtered))

    spectrum = vanishing.filter_spectrum((size, size), angle, frequency).numpy()
    np.testing.assert_allclose(spectrum, expected, atol=2e-3 * np.abs(expected).max())


# --- the vote ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("place", "angle", "votes"),  # of the point in row 20, column 50; the diagonal is 200
    [
        ((60.0, 50.0), 93.0, 1 / (1 + (3 * 40 / 200) ** 2)),
        ((60.0, 50.0), 96.0, 0),
        ((100.0, 50.0), 90.0, 0),
        ((10.0, 50.0), 90.0, 0),
    ],
    ids=["misses by 3 degrees", "by more than 5/(1 + 2d)", "beyond the radius", "above the point"],
)
def test_votes_decrease_with_the_angular_error(
    place: tuple[float, float], angle: float, votes: float
) -> None:
    voters = torch.tensor([place]), torch.tensor([angle])

    actual = vanishing.soft_votes(
        torch.tensor([[20.0, 50.0]]), *voters, 200.0, vanishing.VotingSettings()
    )

    assert actual.tolist() == [pytest.approx(votes)]


@pytest.mark.parametrize("left_out", [0, 40])
def test_confident_pixels_aimed_at_a_point_elect_it(left_out: int) -> None:
    orientation, sure = AIMING.clone(), torch.ones(SIZE)
    sure[:, :left_out] = 0
    orientation[:, :left_out] = vanishing.pixel_angles(torch.tensor([50.0, 20.0]), SIZE)[
        :, :left_out
    ]

    point = vanishing.vote_vanishing_point(orientation, sure, vanishing.VotingSettings())

    assert point is not None
    assert math.dist(point.tolist(), POINT.tolist()) <= 2


# --- the borders ------------------------------------------------------------------------


def wedge(first: float, second: float) -> Tensor:
    """Return an image (3, H, W) of a grey road between two rays from the point, green elsewhere."""
    angle = vanishing.pixel_angles(POINT, SIZE)
    road = (angle > first) & (angle < second)
    grey, green = torch.full((3, 1, 1), 0.5), torch.tensor([0.2, 0.5, 0.2])[:, None, None]
    return torch.where(road, grey, green) + 0.1 * random(3, *SIZE, dtype=torch.float32)


@pytest.mark.parametrize(("first", "second"), [(45, 130), (70, 140)])
def test_both_borders_of_a_road_are_found_and_it_lies_between(first: int, second: int) -> None:
    borders = vanishing.find_borders(
        wedge(first, second), AIMING, POINT, vanishing.BorderSettings()
    )

    assert sorted((borders.first, borders.second)) == [first, second]
    assert torch.equal(borders.point, POINT)
    angle = vanishing.pixel_angles(POINT, SIZE)
    below = torch.arange(SIZE[0])[:, None] > POINT[0] + 1
    expected = (angle > first) & (angle < second) & below
    assert (vanishing.road_between(borders, SIZE) == expected).float().mean() > 0.98
