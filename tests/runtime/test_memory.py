"""The most memory that a process has held."""

import subprocess
import sys

import pytest

from roadtorch.runtime.memory import forget_peak, peak_mebibytes

TOLD = "from roadtorch.runtime.memory import *; print(peak_mebibytes())"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a peak cannot be forgotten")
def test_it_is_what_the_process_held_although_it_let_go_of_it() -> None:
    forget_peak()
    before = peak_mebibytes()
    held = bytearray(64 * 2**20)
    for place in range(0, len(held), 4096):  # pages count when they are written
        held[place] = 1
    del held

    assert before + 60 < peak_mebibytes() < before + 90


def test_it_is_not_that_of_the_process_which_started_it() -> None:
    own = peak_mebibytes()

    told = subprocess.check_output([sys.executable, "-c", TOLD], text=True)

    assert 1 < float(told) < own - 50  # this process has loaded torch
