"""What the tests of all classifiers have in common: classifiers, readings, samples."""

from collections.abc import Iterator
from functools import cache
from typing import Any, get_args

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.oneclass import CLASSIFIERS, Fitted, axes_of, fit
from roadtorch.oneclass.base import Classifier, ClassifierSettings

RGB = axes_of(("R", "G", "B"))
PLANES = {1: ("nr",), 2: ("nr", "ng"), 3: ("R", "G", "B")}
DIMENSIONS = pytest.mark.parametrize("dimensions", PLANES)
HS = axes_of(("H", "S"))
HISTOGRAMS = {name for name in CLASSIFIERS if name.startswith("hist")}
SPREAD = 0.02


def words_of(annotation: Any) -> Iterator[str]:
    """The words that a setting may be, wherever in its type they stand."""
    for part in get_args(annotation):
        if isinstance(part, str):
            yield part
        else:
            yield from words_of(part)


@cache
def of_asphalt(classifier: Classifier) -> Fitted:
    """A classifier as it comes, fitted to ``asphalt()`` once: not to be changed."""
    return fit(classifier, asphalt(), RGB)


def readings(*left_out: str) -> list[Any]:
    """Every classifier with every other reading of the paper that it can be told, one at a time.

    left_out: names of settings that do not matter. Defaults are what all other tests look at.
    """
    return [
        pytest.param(classifier, {name: word}, id=f"{classifier.name}-{name}={word}")
        for classifier in CLASSIFIERS.values()
        for name, field in classifier.settings.model_fields.items()
        for word in words_of(field.annotation)
        if word != field.default and name not in left_out
    ]


every_classifier = pytest.mark.parametrize(
    "classifier", CLASSIFIERS.values(), ids=CLASSIFIERS.keys()
)
every_distance = pytest.mark.parametrize(
    "classifier",
    [classifier for name, classifier in CLASSIFIERS.items() if name not in HISTOGRAMS],
    ids=[name for name in CLASSIFIERS if name not in HISTOGRAMS],
)


def kept(fitted: Fitted, name: str) -> Tensor:
    """What a classifier keeps of its samples, by the name under which its distance takes it."""
    return fitted.learned.distance.keywords[name]  # type: ignore[attr-defined]


def some(number: int, dimensions: int, seed: int = 0, spread: float = 1.0) -> Tensor:
    """Samples (number,dimensions), even in a box of that side around 0.4 (of side 1: 0 to 1)."""
    generator = torch.Generator().manual_seed(seed)
    return 0.4 + spread * (torch.rand(number, dimensions, generator=generator) - 0.4)


def fitted(
    classifier: Classifier, samples: Tensor, settings: ClassifierSettings | None = None
) -> Fitted:
    """A classifier fitted to samples (m,d) of some d planes."""
    return fit(classifier, samples, axes_of(PLANES[samples.shape[1]]), settings)


def doubles(values: Tensor) -> np.ndarray:
    return values.double().numpy()


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
