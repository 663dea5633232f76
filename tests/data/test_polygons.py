"""Polygons as pixels."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.data.correction_formats import fill_area
from roadtorch.data.polygons import fill_polygon
from tests.reference.polygons import contains, edges, is_on, is_on_drawn_border

SIZE = (12, 16)
corners = st.lists(
    st.tuples(st.integers(-8, 24), st.integers(-8, 20)), min_size=3, max_size=6
)  # beyond the picture too


Fill = Callable[[np.ndarray, np.ndarray, int], None]


def filled(points: list[tuple[float, float]], fill: Fill = fill_polygon) -> np.ndarray:
    canvas = np.zeros(SIZE, np.uint8)
    fill(np.array(points, np.float64), canvas, 1)
    return canvas > 0


def box(left: float, top: float, right: float, bottom: float) -> list[tuple[float, float]]:
    return [(left, top), (right, top), (right, bottom), (left, bottom)]


def square(size: tuple[int, int], has: Callable[[int, int], bool]) -> np.ndarray:
    return np.array([[has(x, y) for x in range(size[1])] for y in range(size[0])])


@settings(max_examples=25)
@given(corners)
def test_a_polygon_is_its_inside_and_its_border(points):
    found = filled(points)

    inside = square(SIZE, lambda x, y: contains(x, y, points))
    border = square(SIZE, lambda x, y: bool(found[y, x]) and is_on_drawn_border(x, y, points))
    assert found[inside].all()
    assert (found == inside | border).all()


@settings(max_examples=25)
@given(corners)
def test_an_area_has_the_pixels_whose_centres_are_inside(points):
    found = filled(points, fill_area)

    doubled = [(2 * x, 2 * y) for x, y in points]  # so that centres are at odd numbers
    border = square(SIZE, lambda x, y: any(is_on(2 * x + 1, 2 * y + 1, e) for e in edges(doubled)))
    inside = square(SIZE, lambda x, y: contains(2 * x + 1, 2 * y + 1, doubled))
    assert (found == inside)[~border].all()


@pytest.mark.parametrize(
    ("points", "pixels"),
    [
        (box(2, 3, 9, 8), 8 * 6),  # both borders belong to it
        (box(9, 8, 2, 3), 8 * 6),
        (box(2.4, 2.6, 9.4, 8.4), 8 * 6),  # corners go to the nearest pixel
        (box(-20, -20, 40, 40), 12 * 16),
        (box(20, 20, 30, 30), 0),
        (box(-4, -4, 0, 0), 1),
        ([(5, 5), (5, 5), (5, 5)], 1),
        ([(0, 0), (15, 0), (15, 0)], 16),
    ],
)
def test_pixels_of_a_polygon(points, pixels):
    assert filled(points).sum() == pixels
