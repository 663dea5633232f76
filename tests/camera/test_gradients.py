"""The horizon of one picture, from what its layout shows."""

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.camera.gradients import horizon_of
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.testing.scenes import draw_street, render_scene


def potentials(layout: Tensor) -> Tensor:
    return torch.nn.functional.one_hot(layout.long(), 3).permute(2, 0, 1).float()


@pytest.mark.parametrize("seed", [0, 3, 4, 14])
def test_a_true_layout_tells_the_horizon(seed: int) -> None:
    scene = render_scene(seed)

    found = horizon_of(scene.image, potentials(scene.layout))

    assert found.row == pytest.approx(draw_street(np.random.default_rng(seed)).horizon, abs=0.04)
    assert found.spread >= 0.025


@pytest.mark.parametrize(
    ("top", "told"),
    [
        (119, "too little ground"),
        (0, "ground up to its upper edge"),
        (110, "lines that meet at row"),
    ],
)
def test_what_no_horizon_can_be_told_from_is_refused(top: int, told: str) -> None:
    image = render_scene(3, 120, 160).image
    layout = torch.zeros(120, 160)
    layout[top:] = HORIZONTAL
    layout[:, : (150 if told.startswith("too") else 0)] = 0

    with pytest.raises(InputError, match=told):
        horizon_of(image, potentials(layout))
