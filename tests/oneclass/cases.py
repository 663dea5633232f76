"""What the tests of all classifiers have in common: classifiers, readings, samples."""

from collections.abc import Iterator
from typing import Any, get_args

import pytest
import torch
from torch import Tensor

from roadtorch.oneclass import CLASSIFIERS, axes_of

RGB = axes_of(("R", "G", "B"))
HS = axes_of(("H", "S"))
HISTOGRAMS = {"hist64_s", "hist64_sn", "hist100_s", "hist100_sn"}
SPREAD = 0.02


def words_of(annotation: Any) -> Iterator[str]:
    """The words that a setting may be, wherever in its type they stand."""
    for part in get_args(annotation):
        if isinstance(part, str):
            yield part
        else:
            yield from words_of(part)


READINGS = [
    pytest.param(classifier, {name: word}, id=f"{classifier.name}-{name}={word}")
    for classifier in CLASSIFIERS.values()
    for name, field in classifier.settings.model_fields.items()
    for word in words_of(field.annotation)
]
"""Every classifier with every reading of the paper that it can be told, one at a time."""

every_classifier = pytest.mark.parametrize(
    "classifier", CLASSIFIERS.values(), ids=CLASSIFIERS.keys()
)
every_distance = pytest.mark.parametrize(
    "classifier",
    [classifier for name, classifier in CLASSIFIERS.items() if name not in HISTOGRAMS],
    ids=[name for name in CLASSIFIERS if name not in HISTOGRAMS],
)


def asphalt(count: int = 90, seed: int = 0) -> Tensor:
    """Samples (count,3) of a grey with some noise."""
    generator = torch.Generator().manual_seed(seed)
    return 0.45 + SPREAD * torch.randn(count, 3, generator=generator)


def colours(count: int = 500, seed: int = 1, planes: int = 3) -> Tensor:
    return torch.rand(count, planes, generator=torch.Generator().manual_seed(seed))


def around_red(count: int = 90, seed: int = 0) -> Tensor:
    """Hue on both sides of red, where it begins and ends, and some saturation."""
    generator = torch.Generator().manual_seed(seed)
    hue = (0.02 * torch.randn(count, generator=generator)).remainder(1)
    saturation = 0.4 + 0.02 * torch.randn(count, generator=generator)
    return torch.stack([hue, saturation], 1)
