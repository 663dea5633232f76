"""Dark pictures made as bright below as a network is used to."""

import pytest
import torch

from roadtorch.imaging.color import STRONGEST, Exposure, brightened
from tests.draws import random


@pytest.mark.parametrize("grey", [0.1, 0.2, 0.35])
def test_the_lower_part_of_a_dark_picture_reaches_the_level(grey: float) -> None:
    image = torch.full((3, 20, 30), grey)
    image[:, :11] = 0.9  # the sky: rows above 0.55 of the height do not count

    bright = brightened(image, Exposure(ground=0.4))

    assert float(bright.mean(0)[11:].median()) == pytest.approx(0.4, abs=1e-4)


@pytest.mark.parametrize("dark", [0.02, 0.1, 0.3, 0.6])
def test_brightening_keeps_the_order_of_values_and_the_range(dark: float) -> None:
    image = random(3, 24, 32) * dark
    image[:, 0, 0], image[:, 0, 1] = 0.0, 1.0

    bright = brightened(image, Exposure())

    order = image.reshape(-1).argsort(stable=True)
    assert (bright.reshape(-1)[order].diff() >= 0).all()
    assert (bright >= image).all()
    assert bright.max() <= 1
    assert bright[:, 0, 1].tolist() == [1, 1, 1]


@pytest.mark.parametrize(("grey", "bright"), [(0.01, 0.01**STRONGEST), (0.0, 0.0)])
def test_the_exponent_has_a_floor_and_a_black_picture_stays_nearly_black(
    grey: float, bright: float
) -> None:
    found = brightened(torch.full((3, 16, 40), grey), Exposure(ground=0.9))

    assert found.unique().numel() == 1
    assert float(found[0, 0, 0]) == pytest.approx(bright, rel=1e-5, abs=0.1 * (grey == 0))
