"""The contract for plug-ins finds what breaks it; what tests take for granted of scenes."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from roadtorch.detectors.entry import DetectorSettings, Entry
from roadtorch.testing import ContractError, check_detector
from roadtorch.testing.scenes import ROAD, SCENE_SKY, VOID, render_scene

ANSWERS: dict[str, Callable[[Tensor], dict[str, Tensor]]] = {
    "": lambda image: {"likelihood": image.mean(0)},
    r"of the shape \(15, 16\)": lambda image: {"likelihood": image.mean(0)[:-1]},
    "returns likelihoods from ": lambda image: {"likelihood": image.sum(0)},
    "gives a cue odds that is not finite for a black image": lambda image: {
        "likelihood": image.mean(0),
        "odds": image.mean(0).logit(),
    },
    "is not deterministic: two results": lambda image: {"likelihood": torch.rand(image.shape[1:])},
    "modifies its input image": lambda image: {
        "likelihood": image[0, 0, 0].fill_(0.123).expand(image.shape[1:])
    },
}
"""By what is wrong with it: what a detector answers."""


class Answer(nn.Module):
    """A detector's own part that answers with a function of the image."""

    def __init__(self, wrong: str) -> None:
        super().__init__()
        self.wrong = wrong

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        return ANSWERS[self.wrong](image)


def entry_of(build: Callable[[Any], nn.Module]) -> Entry:
    return Entry("theirs", "", DetectorSettings, build)


def test_a_proper_detector_passes_with_the_settings_given() -> None:
    seen: list[float] = []

    def build(settings: DetectorSettings) -> nn.Module:
        seen.append(settings.threshold)
        return Answer("")

    check_detector(entry_of(build), threshold=0.25)

    assert seen == [0.25, 0.25]  # loaded twice


class Closure(nn.Module):
    """The fault that detectors once had: a function over weights that a copy does not replace."""

    def __init__(self, settings: DetectorSettings) -> None:
        super().__init__()
        self.layer = nn.Linear(1, 1)
        self.weight = [self.layer.weight]  # seen by nobody who copies modules

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        return {"likelihood": (image.mean(0) * self.weight[0].detach().sigmoid()[0, 0])}

    def __deepcopy__(self, memo: dict[int, Any]) -> "Closure":
        made = Closure(DetectorSettings())
        made.load_state_dict(self.state_dict())
        made.weight = self.weight
        return made


class DrawnAtLoading(nn.Module):
    """One that is another detector each time it is loaded."""

    def __init__(self, settings: DetectorSettings) -> None:
        super().__init__()
        self.gain = float(torch.rand(()))

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        return {"likelihood": image.mean(0) * self.gain}


@pytest.mark.parametrize(
    ("build", "problem"),
    [
        *((lambda _, problem=problem: Answer(problem), problem) for problem in ANSWERS if problem),
        (Closure, "not use its own weights after copy"),
        (DrawnAtLoading, "is not deterministic: two results for one image$"),
    ],
)
def test_what_it_says_is_checked(build: Callable[[Any], nn.Module], problem: str) -> None:
    with pytest.raises(ContractError, match=f"theirs.* {problem}"):
        check_detector(entry_of(build))


# --- scenes -----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_every_scene_has_road_ahead_pavement_sky_and_walls(seed):
    scene = render_scene(seed, 120, 160)

    assert torch.equal(scene.road, scene.classes == ROAD)
    assert torch.equal(scene.layout == 0, scene.classes == SCENE_SKY)
    assert torch.equal(scene.void, scene.classes == VOID)
    assert (scene.layout[scene.road] == 2).all()
    assert 0.12 < scene.road.float().mean() < 0.6
    assert all((scene.layout == kind).float().mean() > 0.02 for kind in range(3))
    assert not scene.road[:20].any()
    # The seed area of the papers: 30 by 80 at the bottom centre of 240 by 320.
    assert scene.road[105:, 60:100].float().mean() > 0.9
    assert scene.void.any()


def test_straight_road_is_where_geometry_says():
    # Horizon at row 60 of 120, camera 1.35 m up on the middle of a 7 m road: at the row
    # whose depth is z metres the half road is 3.5·f/z pixels wide, f = 0.95·160.
    scene = render_scene(
        5, 120, 160, horizon=0.5, curvature=0, heading=0, offset=0, road_width=7, cars=0
    )

    row = 80
    depth = 0.95 * 160 * 1.35 / (row + 0.25 - 60)
    half = 3.5 * 0.95 * 160 / depth
    columns = torch.nonzero(scene.road[row]).flatten()
    assert columns.min() == pytest.approx(80 - half, abs=1)
    assert columns.max() == pytest.approx(80 + half, abs=1)
