"""Flicker: shares of changed decisions in closed form."""

import math
from itertools import pairwise

import pytest
import torch

from roadtorch.evaluation.flicker import Changes, Followed, count_changes, flicker, followed
from roadtorch.scenes.street import render_scene

HEIGHT, WIDTH = 40, 60


def moving(right: float = 0.0, down: float = 0.0, sure: torch.Tensor | None = None) -> Followed:
    flow = torch.tensor([right, down]).expand(HEIGHT, WIDTH, 2).contiguous()
    everywhere = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    return Followed(flow, everywhere if sure is None else sure)


def left(columns: int) -> torch.Tensor:
    mask = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    mask[:, :columns] = True
    return mask


def test_a_still_scene_whose_mask_alternates_flickers_by_the_share_that_changes() -> None:
    masks = [left(20), left(23), left(20), left(23)]

    found = flicker(count_changes(*pair, moving()) for pair in pairwise(masks))

    assert found == pytest.approx(3 / WIDTH)


def test_a_mask_that_moves_as_the_picture_does_is_steady() -> None:
    masks = [left(20), left(24), left(28)]  # the place at column x was at x - 4

    found = [count_changes(*pair, moving(-4)) for pair in pairwise(masks)]

    assert flicker(found) == 0


def test_a_mask_that_stands_while_the_picture_moves_flickers() -> None:
    assert flicker([count_changes(left(20), left(20), moving(-4))]) == pytest.approx(4 / WIDTH)


def test_pixels_that_cannot_be_followed_are_not_compared() -> None:
    sure = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    sure[:, 40:] = True

    found = count_changes(left(20), left(23), moving(sure=sure))

    assert found == Changes(0, HEIGHT * 20)


def test_motion_may_have_another_size_than_the_mask() -> None:
    before, mask = (torch.zeros(80, 120, dtype=torch.bool) for _ in range(2))
    before[:, :40], mask[:, :48] = True, True

    assert flicker([count_changes(before, mask, moving(-4))]) == 0


def test_nothing_compared_has_no_flicker() -> None:
    assert math.isnan(flicker([]))
    assert math.isnan(flicker([Changes(0, 0)]))


def test_a_picture_that_moves_is_followed_but_for_what_comes_into_view() -> None:
    street = render_scene(1, 120, 166, noise=0.0).image
    before, image = street[..., 6:].contiguous(), street[..., :-6].contiguous()

    motion = followed(before, image)

    # The first columns were outside the frame before.
    assert not motion.sure[:, :4].any()
    assert motion.sure[:, 20:-20].float().mean() > 0.95
    assert float(motion.flow[20:-20, 30:-30, 0].median()) == pytest.approx(-6, abs=0.1)
