"""What weights say of the people behind them, so that nothing they find is called label-free."""

from collections.abc import Mapping, Sequence
from typing import Any

from roadtorch.layout.weights import people_behind, weights_path
from roadtorch.train.config import PictureTraining, Training


def corrections_behind(training: Training) -> list[Mapping[str, Any]]:
    """The corrections behind what a training begins with: its start, and its teacher's weights.

    WeightsError for a weight file that cannot be used.
    """
    names = [training.start]
    if isinstance(training, PictureTraining):
        names.append(training.teacher.weights)
    found = [one for name in names if name for one in people_behind(weights_path(name))]
    return [one for number, one in enumerate(found) if one not in found[:number]]


def card_of(behind: Sequence[Mapping[str, Any]]) -> str:
    """The card beside weights that were trained with corrections of people."""
    lines = [
        "# Weights trained with corrections of people",
        "",
        "People corrected machine labels, and what they said counted as the truth. What is found",
        "with these weights is **not label-free**, and is not to be reported as such.",
        "",
        "| pictures | people | pixels | sha256 of what was said |",
        "|---|---|---|---|",
    ]
    keys = ("pictures", "people", "pixels", "sha256")
    lines += ["| " + " | ".join(str(one.get(key, "")) for key in keys) + " |" for one in behind]
    return "\n".join([*lines, ""])
