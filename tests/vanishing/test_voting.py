"""The vote for the vanishing point."""

import math

import pytest
import torch
from torch import Tensor

from roadtorch.vanishing.voting import (
    Voters,
    VotingSettings,
    angle_between,
    soft_votes,
    vote_vanishing_point,
)


def aiming_at(row: float, column: float, height: int, width: int) -> Tensor:
    """Orientations (H,W) in degrees of pixels all of which aim at a point."""
    down = torch.arange(height)[:, None] - row
    right = torch.arange(width) - column
    return torch.atan2(down, right).rad2deg().remainder(180)


@pytest.mark.parametrize(
    ("one", "other", "degrees"), [(0, 179, 1), (10, 100, 90), (-30, 150, 0), (170, 20, 30)]
)
def test_angles_are_between_lines_without_a_sense(one: int, other: int, degrees: int) -> None:
    assert float(angle_between(torch.tensor(one), torch.tensor(other))) == degrees


def test_a_voter_gives_the_less_the_more_and_the_farther_it_misses() -> None:
    # 40 pixels straight below the point, its texture 3 degrees off; the diagonal is 200.
    voters = Voters(torch.tensor([[60.0, 50.0]]), torch.tensor([93.0]), 200.0)

    found = soft_votes(torch.tensor([[20.0, 50.0]]), voters, VotingSettings())

    assert float(found[0]) == pytest.approx(1 / (1 + (3 * 40 / 200) ** 2))


@pytest.mark.parametrize(
    ("place", "angle"),
    [((60.0, 50.0), 96.0), ((100.0, 50.0), 90.0), ((10.0, 50.0), 90.0)],
    ids=["misses by more than 5/(1 + 2d)", "beyond the radius", "above the point"],
)
def test_others_give_nothing(place: tuple[float, float], angle: float) -> None:
    voters = Voters(torch.tensor([place]), torch.tensor([angle]), 200.0)

    assert float(soft_votes(torch.tensor([[20.0, 50.0]]), voters, VotingSettings())[0]) == 0


def test_pixels_that_aim_at_a_point_elect_it() -> None:
    orientation = aiming_at(31, 66, 90, 120)

    found = vote_vanishing_point(orientation, torch.ones(90, 120), VotingSettings())

    assert found is not None
    assert math.dist(found.tolist(), (31, 66)) <= 2


def test_those_who_are_not_sure_do_not_vote() -> None:
    orientation, sure = aiming_at(31, 66, 90, 120), torch.zeros(90, 120)
    wrong = aiming_at(50, 20, 90, 120)
    sure[:, 40:] = 1
    orientation[:, :40] = wrong[:, :40]

    found = vote_vanishing_point(orientation, sure, VotingSettings())

    assert found is not None
    assert math.dist(found.tolist(), (31, 66)) <= 3


def test_where_nobody_votes_there_is_no_point() -> None:
    assert vote_vanishing_point(torch.zeros(20, 30), torch.zeros(20, 30), VotingSettings()) is None
