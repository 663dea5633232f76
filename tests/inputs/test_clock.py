"""The time of frames: steps, gaps, repeats and missing stamps never cost a frame or turn back."""

import warnings
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.inputs.clock import FrameClock

TENTH = 0.1


def times(stamps: list[float | None], elapsed: list[float] | None = None) -> list[float]:
    clock, elapsed = FrameClock("drive", TENTH), elapsed or [0.0] * len(stamps)
    return [clock.seconds(*pair) for pair in zip(stamps, elapsed, strict=True)]


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        ([0.0, 0.1, 7.5, 7.6], [0.0, 0.1, 7.5, 7.6]),  # a gap
        ([0.0, 0.1, None, 0.3], [0.0, 0.1, 0.2, 0.3]),  # a missing stamp
        ([None, None, None], [0.0, 0.1, 0.2]),
        ([0.0, 0.0, 0.0, 0.4], [0.0, 0.1, 0.2, 0.4]),  # a clock that stands
        ([-0.2, -0.1, 0.0], [0.0, 0.1, 0.2]),  # a start before that of the container
    ],
)
def test_stamps_that_advance_are_kept_and_gaps_between_them_filled(
    stamps: list[float | None], expected: list[float]
) -> None:
    assert times(stamps) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("stamps", "elapsed", "change", "expected"),
    [
        # Joined recordings; the first stamp ahead; neighbours that are swapped, without a drift.
        ([0.0, 0.1, 0.2, 0.0, 0.1], 0.0, "-0.3", [0.0, 0.1, 0.2, 0.3, 0.4]),
        ([0.0, -9e5, 0.1 - 9e5], 0.0, "-900000.1", [0.0, 0.1, 0.2]),
        ([0.0, 0.2, 0.1, 0.5, 0.4, 0.6], 0.0, "-0.2", [0.0, 0.2, 0.3, 0.5, 0.6, 0.6]),
        # By another clock: one that was set ahead; a single wrong stamp.
        ([0.0, 0.1, 9e8, 9e8 + 0.1], TENTH, r"\+899999999.8", [0.0, 0.1, 0.2, 0.3]),
        ([0.0, 0.1, 900.0, 0.3, 0.4], TENTH, r"\+899.8", [0.0, 0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_a_step_is_reported_once_and_time_goes_on(
    stamps: list[float | None], elapsed: float, change: str, expected: list[float]
) -> None:
    with pytest.warns(UserWarning, match=f"^drive: the clock steps by {change} s at ") as caught:
        seconds = times(stamps, [elapsed] * len(stamps))

    assert seconds == pytest.approx(expected)
    assert len(caught) == 1


STAMPS = st.lists(st.none() | st.sampled_from([0.0, 0.1, 1.7e9]) | st.floats(-1e10, 1e10))


@given(STAMPS, st.sampled_from([0.0, TENTH, 4e4]))
def test_no_stamps_turn_time_back(stamps: list[float | None], elapsed: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        seconds = times(stamps, [elapsed] * len(stamps))

    assert len(seconds) == len(stamps)
    assert all(0 <= early <= late for early, late in pairwise([0.0, *seconds]))
