"""Boundary F against brute force on small masks, and cases drawn by hand."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.evaluation import boundary
from roadtorch.evaluation.measures import BORDERS
from tests.reference import boundary as slow

# 12 x 16: the diagonal is exactly 20, so tolerances in pixels are whole twentieths.
SIZE = (12, 16)
PIXEL = 1 / 20


def half(column: int, size: tuple[int, int] = SIZE) -> Tensor:
    """Road left of a column."""
    return (torch.arange(size[1]) < column).expand(size).contiguous()


def everything(size: tuple[int, int] = SIZE) -> Tensor:
    return torch.ones(size, dtype=torch.bool)


def blob(generator: np.random.Generator) -> np.ndarray:
    """A ragged mask: two rectangles and a few flipped pixels."""
    mask = np.zeros(SIZE, bool)
    for _ in range(2):
        (top, bottom), (left, right) = (np.sort(generator.integers(0, n, 2)) for n in SIZE)
        mask[top : bottom + 1, left : right + 1] ^= True
    return mask ^ (generator.random(SIZE) < 0.02)


# --- brute force ----------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_counts_equal_looking_at_every_pair_of_pixels(seed):
    generator = np.random.default_rng(seed)
    mask, road = blob(generator), blob(generator)
    if seed % 2:  # a small road, of which what is far is not looked at
        top, left = (generator.integers(1, side) for side in SIZE)
        road[:top] = road[:, :left] = False
    valid = generator.random(SIZE) < generator.choice([0.8, 1.0])
    tolerances = (0.0, 1 * PIXEL, 2 * PIXEL, 0.123, 5 * PIXEL, 10 * PIXEL)

    maps = (torch.from_numpy(mask), torch.from_numpy(road), torch.from_numpy(valid))
    found = boundary.count_boundary(*maps, tolerances)

    assert found.dtype == torch.int64
    assert found.tolist() == [slow.count(mask, road, valid, share) for share in tolerances]


# --- what a border is -----------------------------------------------------------------------------


def test_the_border_is_the_masks_own_last_pixel():
    found = boundary.border(half(5), everything())

    assert found.nonzero()[:, 1].unique().tolist() == [4]
    assert int(found.sum()) == 12
    assert not boundary.border(everything(), everything()).any()  # the frame is no border


def test_meeting_void_is_no_border():
    valid = everything()
    valid[:, 5:8] = False

    assert not boundary.border(half(5), valid).any()  # void begins where the road ends
    assert not boundary.border(half(6), valid).any()  # the end lies in void
    assert boundary.border(half(4), valid).any()


def test_what_lies_in_void_changes_nothing():
    valid = everything()
    valid[6:, :] = False
    mask, road = half(5), half(6)
    other_mask, other_road = mask.clone(), road.clone()
    other_mask[7:], other_road[7:] = True, False

    found = boundary.count_boundary(mask, road, valid)

    assert torch.equal(found, boundary.count_boundary(other_mask, other_road, valid))
    assert found[0].tolist() == [0, 6, 0, 6]


# --- tolerance and F ------------------------------------------------------------------------------


def test_a_shift_is_forgiven_from_its_own_width_on():
    counts = boundary.count_boundary(
        half(5), half(7), everything(), (1 * PIXEL, 1.9 * PIXEL, 2 * PIXEL, 3 * PIXEL)
    )

    assert boundary.boundary_f(counts).tolist() == [0, 0, 1, 1]


def test_tolerances_mean_the_same_at_any_size():
    large = (120, 160)
    small_f, large_f = (
        boundary.boundary_f(
            boundary.count_boundary(half(5 * k, s), half(7 * k, s), everything(s), (0.09, 0.11))
        ).tolist()
        for k, s in ((1, SIZE), (10, large))
    )

    assert small_f == large_f == [0, 1]


def test_distances_are_straight_lines_to_the_last_digit():
    # Two single pixels, 7 rows and 24 columns apart: 25 pixels. The diagonal is 100.
    mask, road = torch.zeros(2, 60, 80, dtype=torch.bool)
    mask[10, 10] = road[17, 34] = True

    counts = boundary.count_boundary(mask, road, everything((60, 80)), (0.2499, 0.25))

    assert boundary.boundary_f(counts).tolist() == [0, 1]


def test_precision_is_of_the_decided_border_and_recall_of_the_true_one():
    # The true border is found; 12 more border pixels are decided elsewhere.
    mask = half(5)
    mask[:, 10:] = True

    counts = boundary.count_boundary(mask, half(5), everything(), (PIXEL,))

    assert counts.tolist() == [[12, 24, 12, 12]]
    assert float(boundary.boundary_f(counts)) == pytest.approx(2 * 0.5 * 1 / 1.5)


def test_no_border_at_all_is_nan_and_one_alone_is_0():
    nothing, all_valid = torch.zeros(SIZE, dtype=torch.bool), everything()

    neither = boundary.count_boundary(nothing, nothing, all_valid)
    only_true = boundary.count_boundary(nothing, half(5), all_valid)
    only_decided = boundary.count_boundary(half(5), all_valid, all_valid)

    assert all(math.isnan(f) for f in boundary.boundary_f(neither).tolist())
    assert boundary.boundary_f(only_true).tolist() == [0, 0, 0]
    assert boundary.boundary_f(only_decided).tolist() == [0, 0, 0]


# --- properties -----------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_f_grows_with_the_tolerance_and_does_not_care_who_is_who(seed):
    generator = np.random.default_rng(seed)
    mask, road = (torch.from_numpy(blob(generator)) for _ in range(2))
    tolerances = (0.0, 0.05, 0.1, 0.5)

    there = boundary.boundary_f(boundary.count_boundary(mask, road, everything(), tolerances))
    back = boundary.boundary_f(boundary.count_boundary(road, mask, everything(), tolerances))

    assert there.tolist() == pytest.approx(back.tolist(), nan_ok=True)
    defined = there[~there.isnan()]
    assert bool((defined.diff() >= 0).all())


def test_a_mask_equal_to_the_truth_has_f_1_and_counts_add_up():
    road, valid = half(5), everything()

    one, two = (boundary.count_boundary(mask, road, valid) for mask in (road, half(9)))

    assert boundary.boundary_f(one).tolist() == [1, 1, 1]
    assert boundary.boundary_f(one + two).tolist() == [0.5, 0.5, 0.5]
    assert boundary.boundary_f(torch.stack([one, two])).tolist() == [[1] * 3, [0] * 3]


def test_figures_are_named_by_their_tolerance():
    values = boundary.boundary_f(boundary.count_boundary(half(5), half(5), everything())).tolist()

    figures = dict(zip((one.key for one in BORDERS), values, strict=True))
    assert figures == {"boundary_f/0.0025": 1, "boundary_f/0.005": 1, "boundary_f/0.0075": 1}
