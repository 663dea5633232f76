"""The contract for plug-ins finds what breaks it, promise by promise."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from roadtorch.detectors.detector import DetectorSettings, Entry
from roadtorch.testing import BrokenPromiseError, broken_promises, check_detector


class Answer(nn.Module):
    """A detector's own part that answers with a function of the image."""

    def __init__(self, answer: Callable[[Tensor], dict[str, Tensor]]) -> None:
        super().__init__()
        self.answer = answer

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        return self.answer(image)


def brightness(image: Tensor) -> dict[str, Tensor]:
    return {"likelihood": image.mean(0)}


def too_small(image: Tensor) -> dict[str, Tensor]:
    return {"likelihood": image.mean(0)[:-1]}


def too_bright(image: Tensor) -> dict[str, Tensor]:
    return {"likelihood": image.sum(0)}


def endless_cue(image: Tensor) -> dict[str, Tensor]:
    return {"likelihood": image.mean(0), "odds": image.mean(0).logit()}


def random(image: Tensor) -> dict[str, Tensor]:
    return {"likelihood": torch.rand(image.shape[1:])}


def greedy(image: Tensor) -> dict[str, Tensor]:
    image[0, 0, 0] = 0.123
    return {"likelihood": image.mean(0)}


def entry_of(build: Callable[[Any], nn.Module]) -> Entry:
    return Entry("theirs", "", DetectorSettings, build)


def test_a_proper_detector_passes() -> None:
    check_detector(entry_of(lambda settings: Answer(brightness)))


@pytest.mark.parametrize(
    ("answer", "what"),
    [
        (too_small, r"gives \(15, 16\) for 16×16 pixels"),
        (too_bright, r"leaves \[0, 1\]"),
        (endless_cue, "gives a cue odds that is not finite for a black picture"),
        (random, "says two things of one image"),
        (greedy, "changes the image"),
    ],
)
def test_what_it_says_is_checked(answer: Callable[[Tensor], dict[str, Tensor]], what: str) -> None:
    with pytest.raises(BrokenPromiseError, match=f"theirs {what}"):
        check_detector(entry_of(lambda settings: Answer(answer)))


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


def test_a_copy_that_uses_the_weights_of_the_first_is_found() -> None:
    with pytest.raises(BrokenPromiseError, match="not use its own weights after copy"):
        check_detector(entry_of(Closure))


class DrawnAtLoading(nn.Module):
    """One that is another detector each time it is loaded."""

    def __init__(self, settings: DetectorSettings) -> None:
        super().__init__()
        self.gain = float(torch.rand(()))

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        return {"likelihood": image.mean(0) * self.gain}


def test_a_detector_that_loads_differently_each_time_is_found() -> None:
    assert broken_promises(entry_of(DrawnAtLoading)) == ["theirs says two things of one image"]


def test_settings_reach_the_detector_that_is_checked() -> None:
    seen: list[float] = []

    def build(settings: DetectorSettings) -> nn.Module:
        seen.append(settings.threshold)
        return Answer(brightness)

    check_detector(entry_of(build), threshold=0.25)

    assert seen == [0.25, 0.25]  # loaded twice
