"""Rendered drives: a bend's geometry in closed form, and a world that stays where it is."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from roadtorch.evaluation.flicker import count_changes, flicker, followed
from train.rendered_drives import Bend, before_camera, render_drive

BENDS = [Bend(12.0, 25.0, 0.9, side) for side in (-1.0, 1.0)]


@pytest.mark.parametrize("bend", BENDS)
@pytest.mark.parametrize("along", [-3.0, 0.0, 11.9, 12.1, 20.0, 34.4, 34.6, 60.0])
@pytest.mark.parametrize("across", [-4.0, 0.0, 5.0])
def test_places_beside_the_road_have_their_lengths(bend, along, across) -> None:
    place = bend.beside(along, across)

    found = [float(each[0]) for each in bend.lengths(*place[:, None])]

    assert found == pytest.approx([along, across], abs=1e-9)


def test_a_bend_ends_where_a_circle_says() -> None:
    place, heading = Bend(10.0, 20.0, math.pi / 2, 1.0).at(10 + 20 * math.pi / 2 + 5)

    assert place == pytest.approx([25.0, 30.0])
    assert heading == pytest.approx(math.pi / 2)


def test_a_bend_to_the_left_mirrors_one_to_the_right() -> None:
    left, right = (bend.at(40.0) for bend in BENDS)

    assert left[0] == pytest.approx(right[0] * [-1, 1])
    assert left[1] == -right[1]


def test_what_is_behind_the_camera_is_cut_off() -> None:
    square = np.array([[0.0, 0, -1.4], [1, 0, -1.4], [1, 0, 2.6], [0, 0, 2.6]])

    cut = before_camera(square)

    assert sorted(cut[:, 2]) == pytest.approx([0.6, 0.6, 2.6, 2.6])
    assert len(before_camera(square - [0, 0, 9])) == 0


@pytest.fixture(scope="module")
def drive():
    return list(render_drive(1, 4, 120, 214, rate=30.0))


def test_a_seed_is_one_drive(drive) -> None:
    again = render_drive(1, 4, 120, 214, rate=30.0)

    assert all(torch.equal(a.image, b.image) for a, b in zip(drive, again, strict=True))
    assert not torch.equal(drive[0].image, next(render_drive(2, 1, 120, 214)).image)


def test_frames_differ_and_have_road_and_exact_types(drive) -> None:
    for frame in drive:
        assert frame.image.shape == (3, 120, 214)
        assert frame.road.dtype == torch.bool
        assert 0.1 < frame.road.float().mean() < 0.6
        assert frame.road[-20:, 80:134].float().mean() > 0.9
    assert not torch.equal(drive[0].road, drive[3].road)


def test_the_true_road_moves_as_the_picture_does(drive) -> None:
    moved = [followed(a.image, b.image) for a, b in pairwise(drive)]

    changes = [
        count_changes(a.road, b.road, motion)
        for (a, b), motion in zip(pairwise(drive), moved, strict=True)
    ]

    assert flicker(changes) < 0.01


def test_options_fix_the_street() -> None:
    with pytest.raises(TypeError, match="rain"):
        next(render_drive(0, 1, 60, 80, rain=1))
    dark, light = (next(render_drive(0, 1, 60, 80, dusk=dusk)) for dusk in (0.9, 0.0))
    assert dark.image.mean() < 0.8 * light.image.mean()
    assert torch.equal(dark.classes, light.classes)
