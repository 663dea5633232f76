"""Boundary F against brute force on small masks, and cases by hand."""

import math

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.evaluation import boundary
from tests.reference import boundary as slow

# 12 x 16: the diagonal is exactly 20, so tolerances in pixels are whole twentieths.
SIZE = (12, 16)
PIXEL = 1 / 20


def half(column: int, size: tuple[int, int] = SIZE) -> Tensor:
    """Return road to the left of a column."""
    return (torch.arange(size[1]) < column).expand(size).contiguous()


def everything(size: tuple[int, int] = SIZE) -> Tensor:
    return torch.ones(size, dtype=torch.bool)


def blob(generator: np.random.Generator) -> np.ndarray:
    """Return a ragged mask: two rectangles and a few flipped pixels."""
    mask = np.zeros(SIZE, bool)
    for _ in range(2):
        (top, bottom), (start, end) = (np.sort(generator.integers(0, n, 2)) for n in SIZE)
        mask[top : bottom + 1, start : end + 1] ^= True
    return mask ^ (generator.random(SIZE) < 0.02)


# --- brute force ----------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_counts_equal_looking_at_every_pair_of_pixels(seed):
    generator = np.random.default_rng(seed)
    mask, road = blob(generator), blob(generator)
    if seed % 2:  # a small road, of which what is far is not looked at
        row, column = (generator.integers(1, side) for side in SIZE)
        road[:row] = road[:, :column] = False
    valid = generator.random(SIZE) < generator.choice([0.8, 1.0])
    tolerances = (0.0, 1 * PIXEL, 2 * PIXEL, 0.123, 5 * PIXEL, 10 * PIXEL)

    maps = (torch.from_numpy(mask), torch.from_numpy(road), torch.from_numpy(valid))
    counts = boundary.count_boundary(*maps, tolerances)

    assert counts.dtype == torch.int64
    assert counts.tolist() == [slow.count(mask, road, valid, share) for share in tolerances]


@pytest.mark.parametrize("threads", [1, 2])
def test_a_boundary_exactly_at_the_tolerance_is_within_it(threads):
    # .0075 of the diagonal of 800 x 400 is the root of 45, and (3, 6) is as far.
    mask, road = torch.zeros(2, 800, 400, dtype=torch.bool)
    mask[20:780:40, 20:380:40] = road[23:783:40, 26:386:40] = True
    threads_before = cv2.getNumThreads()
    cv2.setNumThreads(threads)

    counts = boundary.count_boundary(mask, road, torch.ones_like(mask), (0.0075, 0.00749))

    cv2.setNumThreads(threads_before)
    dots = int(mask.sum())
    assert counts.tolist() == [[dots] * 4, [0, dots, 0, dots]]


# --- tolerance and F ------------------------------------------------------------------------------


def test_tolerances_mean_the_same_at_any_size():
    large = (120, 160)
    small_f, large_f = (
        boundary.boundary_f(
            boundary.count_boundary(half(5 * k, s), half(7 * k, s), everything(s), (0.09, 0.11))
        ).tolist()
        for k, s in ((1, SIZE), (10, large))
    )

    assert small_f == large_f == [0, 1]


def test_precision_is_of_the_predicted_boundary_and_recall_of_the_true_one():
    # The true border is found; 12 more border pixels are decided elsewhere.
    mask = half(5)
    mask[:, 10:] = True

    counts = boundary.count_boundary(mask, half(5), everything(), (PIXEL,))

    assert counts.tolist() == [[12, 24, 12, 12]]
    assert float(boundary.boundary_f(counts)) == pytest.approx(2 * 0.5 * 1 / 1.5)


def test_no_boundary_at_all_is_nan_and_one_alone_is_0():
    nothing, all_valid = torch.zeros(SIZE, dtype=torch.bool), everything()

    neither = boundary.count_boundary(nothing, nothing, all_valid)
    only_true = boundary.count_boundary(nothing, half(5), all_valid)
    only_decided = boundary.count_boundary(half(5), all_valid, all_valid)

    assert all(math.isnan(f) for f in boundary.boundary_f(neither).tolist())
    assert boundary.boundary_f(only_true).tolist() == [0] * 2
    assert boundary.boundary_f(only_decided).tolist() == [0] * 2
