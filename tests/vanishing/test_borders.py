"""The borders of the road: rays along which texture runs, with other colours beyond."""

import pytest
import torch
from torch import Tensor

from roadtorch.vanishing.borders import (
    CANDIDATES,
    Borders,
    BorderSettings,
    angles_from,
    colour_difference,
    consistency,
    find_borders,
    road_between,
)

SIZE = (90, 120)
POINT = torch.tensor([25.0, 60.0])


def wedge(first: float, second: float) -> Tensor:
    """A picture (3,H,W) of a grey road between two rays from the point, green elsewhere."""
    angle = angles_from(POINT, SIZE)
    road = (angle > first) & (angle < second)
    noise = torch.rand(3, *SIZE, generator=torch.Generator().manual_seed(0)) * 0.1
    grey, green = torch.full((3, 1, 1), 0.5), torch.tensor([0.2, 0.5, 0.2])[:, None, None]
    return torch.where(road, grey, green) + noise


def test_rays_are_29_from_20_to_160_degrees() -> None:
    assert CANDIDATES.tolist() == list(range(20, 161, 5))


def test_a_ray_along_which_all_texture_runs_is_consistent() -> None:
    orientation = angles_from(POINT, SIZE).remainder(180)
    across = (orientation + 90).remainder(180)

    along, none = (
        consistency(POINT[None], one, BorderSettings())[0] for one in (orientation, across)
    )

    assert (along > 0.95).all()
    assert not none.any()


def test_rays_that_leave_the_picture_soon_are_none() -> None:
    corner = torch.tensor([[60.0, 118.0]])

    found = consistency(corner, angles_from(corner[0], SIZE), BorderSettings())[0]

    assert not found[0]  # 20°, to the right
    assert found[-1] > 0.9  # 160°, to the left


def test_colours_differ_most_at_the_borders() -> None:
    found = colour_difference(wedge(50, 125), POINT, BorderSettings())

    best = CANDIDATES[found.argsort(descending=True)[:2]].tolist()
    assert sorted(best) == [50, 125]


@pytest.mark.parametrize(("first", "second"), [(45, 130), (70, 140)])
def test_both_borders_of_a_road_are_found(first: int, second: int) -> None:
    orientation = angles_from(POINT, SIZE).remainder(180)

    found = find_borders(wedge(first, second), orientation, POINT, BorderSettings())

    assert sorted((found.first, found.second)) == [first, second]
    assert torch.equal(found.point, POINT)


def test_the_point_moves_along_the_first_border_to_where_texture_aims() -> None:
    angle = torch.tensor(130).deg2rad()
    high = POINT - 12 * torch.stack([angle.sin(), angle.cos()])
    orientation = angles_from(POINT, SIZE).remainder(180)

    found = find_borders(wedge(45, 130), orientation, high, BorderSettings())

    assert found.first == 130
    assert float((found.point - POINT).square().sum().sqrt()) < 3


def test_road_lies_between_the_borders_and_below_the_point() -> None:
    found = road_between(Borders(POINT, 120, 60), SIZE)

    assert found[89, 60]
    assert not found[:25].any()
    assert not found[30, 40]
    assert not found[30, 80]
