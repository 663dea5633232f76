"""Sheets of pictures."""

import os

import numpy as np

from roadtorch.report.montage import captioned


def test_a_name_that_is_not_utf_8_can_stand_on_a_tile() -> None:
    tile = captioned(np.zeros((30, 40, 3), np.uint8), os.fsdecode(b"z\xff.jpg"), 30)

    assert tile[:20].any()
