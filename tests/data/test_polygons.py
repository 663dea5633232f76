"""Drawn shapes as pixels, and what follows from several people's drawings."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.data.correction_formats import fill_area
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
from tests.reference.polygons import contains, edges, is_on, is_on_drawn_border

SIZE = (12, 16)
corners = st.lists(
    st.tuples(st.integers(-8, 24), st.integers(-8, 20)), min_size=3, max_size=6
)  # beyond the picture too


def filled(shape: Fill) -> np.ndarray:
    return filled_shapes([(shape, ROAD)], SIZE) == ROAD


def polygon(*points: tuple[float, float]) -> Fill:
    return partial(fill_polygon, np.array(points, np.float64))


def box(left: float, top: float, right: float, bottom: float) -> Fill:
    return polygon((left, top), (right, top), (right, bottom), (left, bottom))


def square(size: tuple[int, int], has: Callable[[int, int], bool]) -> np.ndarray:
    return np.array([[has(x, y) for x in range(size[1])] for y in range(size[0])])


# --- filling -------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(corners)
def test_a_polygon_is_its_inside_and_its_border(points):
    found = filled(polygon(*points))

    inside = square(SIZE, lambda x, y: contains(x, y, points))
    border = square(SIZE, lambda x, y: bool(found[y, x]) and is_on_drawn_border(x, y, points))
    assert found[inside].all()
    assert (found == inside | border).all()


@settings(max_examples=25)
@given(corners)
def test_an_area_has_the_pixels_whose_centres_are_inside(points):
    found = filled(partial(fill_area, np.array(points, np.float64)))

    doubled = [(2 * x, 2 * y) for x, y in points]  # so that centres are at odd numbers
    border = square(SIZE, lambda x, y: any(is_on(2 * x + 1, 2 * y + 1, e) for e in edges(doubled)))
    inside = square(SIZE, lambda x, y: contains(2 * x + 1, 2 * y + 1, doubled))
    assert (found == inside)[~border].all()


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
        (partial(fill_disc, 5, 4, 2), 13),
        *(
            (partial(fill_stamp, left, top, np.ones((2, 3), np.bool_)), pixels)  # at every side
            for left, top, pixels in [(-1, -1, 2), (14, 10, 4), (3, 4, 6), (40, 0, 0)]
        ),
    ],
)
def test_pixels_of_a_shape(shape, pixels):
    assert filled(shape).sum() == pixels


def test_later_shapes_cut_holes_and_blobs_are_united():
    values = filled_shapes(
        [
            (box(0, 0, 9, 9), ROAD),
            (box(5, 5, 12, 9), ROAD),  # overlaps: united, not a hole
            (box(2, 2, 3, 3), OTHER),
            (box(0, 0, 0, 0), VOID),
        ],
        SIZE,
    )

    assert (values == ROAD).sum() == 100 + 15 - 4 - 1
    assert (values[6, 6], values[2, 2], values[0, 0]) == (ROAD, OTHER, VOID)


# --- agreeing ------------------------------------------------------------------------------------

ANNA, BEN = [ROAD, ROAD, VOID, VOID, OTHER], [ROAD, OTHER, ROAD, VOID, OTHER]


@pytest.mark.parametrize(
    ("people", "agreement", "road"),
    [
        ([ANNA, BEN], "majority", [True, False, True, False, False]),
        ([ANNA, BEN], "union", [True, True, True, False, False]),
        ([ANNA, BEN], "intersection", [True, False, True, False, False]),
        ([ANNA, BEN, ANNA], "majority", [True, True, True, False, False]),  # two of three
    ],
)
def test_several_people(people, agreement, road):
    truth = agree([np.array([values], np.uint8) for values in people], (1, 5), agreement)

    assert truth.road[0].tolist() == road
    assert truth.valid[0].tolist() == [True, True, True, False, True]
    assert truth.layout is None


@pytest.mark.parametrize("agreement", ["majority", "union", "intersection"])
def test_nobody_saw_a_road(agreement):
    truth = agree([], (2, 3), agreement)

    assert torch.equal(truth.road, torch.zeros(2, 3, dtype=torch.bool))
    assert truth.valid.all()
