"""What a fitted one-class classifier says of itself, in bytes beside its tensors."""

import json
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from typing import NamedTuple, get_args

from torch import Tensor

from roadtorch.errors import WeightsError
from roadtorch.oneclass.axes import Axes, Hue

LEARNED = "learned."
"""How the names of what was learned begin in a state."""

HUES: dict[str, Hue] = {hue: hue for hue in get_args(Hue)}


class About(NamedTuple):
    """What a fitted classifier is: its name, planes, hue, memory, and the shapes it learned."""

    classifier: str
    axes: Axes
    hue: Hue
    floats: int
    shapes: tuple[tuple[str, tuple[int, ...]], ...]


@cache
def about_as_bytes(about: About) -> bytes:
    """What a state says that it is: JSON as bytes, so that a state holds tensors alone."""
    axes = {field.name: getattr(about.axes, field.name) for field in fields(Axes)}
    return json.dumps({**about._asdict(), "axes": axes}).encode()


def read_about(about: Tensor | None) -> About:
    """The opposite of ``about_as_bytes``; WeightsError where the bytes say no such thing."""
    try:
        told = json.loads(bytes([] if about is None else about.tolist()))
        axes = Axes(**{key: tuple(values) for key, values in told["axes"].items()})
        shapes = tuple((name, tuple(shape)) for name, shape in told["shapes"])
        hue = HUES[told["hue"]]
        return About(told["classifier"], axes, hue, int(told["floats"]), shapes)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
        what = "does not say what it is the state of"
        raise WeightsError("state", what, "give the state of a fitted classifier") from None


def check_classifier(about: About, classifier: str) -> None:
    """WeightsError unless it is the state of that classifier."""
    if about.classifier != classifier:
        what = f"is that of {about.classifier}"
        raise WeightsError("state", what, f"give one of {classifier}")


def check_parts(about: About, state: Mapping[str, Tensor]) -> None:
    """WeightsError unless a state has all that it says it has, and nothing else."""
    expected = {LEARNED + name: shape for name, shape in about.shapes}
    expected |= {"hues": (len(about.axes),), "threshold": ()}
    found = {name: tuple(value.shape) for name, value in state.items() if name != "about"}
    for name in sorted(expected.keys() | found.keys()):
        if found.get(name) != expected.get(name):
            what = f"is incomplete: {name} is {found.get(name, 'missing')}"
            remedy = f"fit and save it again ({expected.get(name, 'nothing')} was expected)"
            raise WeightsError("state", what, remedy)
