"""The most memory that a process has held, in fresh ones: this one may keep what it has freed."""

import subprocess
import sys

import pytest

HELD = """
from roadtorch.base.compute import forget_peak, peak_mebibytes
forget_peak()
before = peak_mebibytes()
held = bytearray(64 * 2**20)
for place in range(0, len(held), 4096):  # pages count when they are written
    held[place] = 1
del held
print(before, peak_mebibytes())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a peak cannot be forgotten")
def test_it_is_what_was_held_though_let_go_of_and_not_what_the_parent_held() -> None:
    parent = bytearray(b"1") * (256 * 2**20)

    told = subprocess.check_output([sys.executable, "-c", HELD], text=True)

    before, peak = map(float, told.split())
    assert 1 < before < len(parent) / 2**20
    assert before + 60 < peak < before + 90
