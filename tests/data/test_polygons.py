"""Drawn shapes as pixels, and what follows from several people's drawings."""

from functools import partial

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.data.polygons import (
    OTHER,
    ROAD,
    VOID,
    Fill,
    agree,
    fill_disc,
    fill_polygon,
    fill_stamp,
    filled_shapes,
)
from tests.reference.polygons import contains, is_on_drawn_border

SIZE = (12, 16)
corners = st.tuples(st.integers(-8, 24), st.integers(-8, 20))


def filled(shape: Fill, size=SIZE) -> np.ndarray:
    return filled_shapes([(shape, ROAD)], size) == ROAD


def polygon(*points: tuple[float, float], moved: float = 0) -> Fill:
    return partial(fill_polygon, np.array(points, np.float64) + moved)


def box(left: float, top: float, right: float, bottom: float) -> Fill:
    return polygon((left, top), (right, top), (right, bottom), (left, bottom))


# --- filling -------------------------------------------------------------------------------------


@settings(max_examples=60)
@given(st.lists(corners, min_size=3, max_size=6))
def test_a_polygon_is_its_inside_and_its_border(points):
    found = filled(polygon(*points))

    for y in range(SIZE[0]):
        for x in range(SIZE[1]):
            if contains(x, y, points):
                assert found[y, x], (x, y)
            elif found[y, x]:
                assert is_on_drawn_border(x, y, points), (x, y)


@pytest.mark.parametrize(
    ("shape", "pixels"),
    [
        (box(2, 3, 9, 8), 8 * 6),  # both borders belong to it
        (box(9, 8, 2, 3), 8 * 6),
        (box(2.4, 2.6, 9.4, 8.4), 8 * 6),  # corners go to the nearest pixel
        (box(-20, -20, 40, 40), 12 * 16),
        (box(20, 20, 30, 30), 0),
        (box(-4, -4, 0, 0), 1),
        (polygon((5, 5), (5, 5), (5, 5)), 1),
        (polygon((0, 0), (15, 0), (15, 0)), 16),
    ],
)
def test_pixels_of_a_polygon(shape, pixels):
    assert filled(shape).sum() == pixels


def test_a_polygon_that_leaves_the_picture_is_cut_not_bent():
    diamond = (8, -20), (40, 6), (8, 32), (-24, 6)
    whole = filled(polygon(*diamond, moved=40), (100, 100))

    assert (filled(polygon(*diamond)) == whole[40:52, 40:56]).all()


def test_a_disc_has_the_pixels_within_its_radius():
    found = filled(partial(fill_disc, 5, 4, 2))

    assert found.sum() == 13
    assert found[4, 3]
    assert found[2, 5]
    assert not found[2, 4]


@pytest.mark.parametrize(
    ("left", "top", "rows", "columns"),
    [(-1, -1, 1, 2), (14, 10, 2, 2), (3, 4, 2, 3), (40, 0, 0, 0)],
)
def test_a_stamp_is_clipped_at_every_side(left, top, rows, columns):
    found = filled(partial(fill_stamp, left, top, np.ones((2, 3), np.bool_)))

    assert found.sum() == rows * columns


# --- painting and agreeing -----------------------------------------------------------------------


def test_two_of_three_are_a_majority():
    said = {"a": one_row(ROAD, ROAD), "b": one_row(ROAD, OTHER), "c": one_row(OTHER, OTHER)}

    assert agree(said, (1, 2), "majority").road[0].tolist() == [True, False]


def test_later_shapes_cut_holes_and_blobs_are_united():
    said = filled_shapes(
        [
            (box(0, 0, 9, 9), ROAD),
            (box(5, 5, 12, 9), ROAD),  # overlaps: united, not a hole
            (box(2, 2, 3, 3), OTHER),
            (box(0, 0, 0, 0), VOID),
        ],
        SIZE,
    )

    assert (said == ROAD).sum() == 100 + 15 - 4 - 1
    assert said[6, 6] == ROAD
    assert said[2, 2] == OTHER
    assert said[0, 0] == VOID


def one_row(*values: int) -> np.ndarray:
    return np.array([values], np.uint8)


@pytest.mark.parametrize(
    ("agreement", "road"),
    [
        ("majority", [True, False, True, False, False]),
        ("union", [True, True, True, False, False]),
        ("intersection", [True, False, True, False, False]),
    ],
)
def test_two_people(agreement, road):
    said = {
        "anna": one_row(ROAD, ROAD, VOID, VOID, OTHER),
        "ben": one_row(ROAD, OTHER, ROAD, VOID, OTHER),
    }

    truth = agree(said, (1, 5), agreement)

    assert truth.road[0].tolist() == road
    assert truth.valid[0].tolist() == [True, True, True, False, True]
    assert truth.layout is None


@pytest.mark.parametrize("agreement", ["majority", "union", "intersection"])
def test_nobody_saw_a_road(agreement):
    truth = agree({}, (2, 3), agreement)

    assert torch.equal(truth.road, torch.zeros(2, 3, dtype=torch.bool))
    assert truth.valid.all()
