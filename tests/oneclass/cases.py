"""Cases for the tests of all classifiers: classifiers, readings of the paper, samples."""

from collections.abc import Iterator
from functools import cache
from typing import Any, get_args

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.oneclass import CLASSIFIERS, FittedClassifier, fit, make_axes
from roadtorch.oneclass.base import Classifier, ClassifierSettings
from tests.draws import seeded_generator

PLANES = {
    1: make_axes(("nr",)),
    2: make_axes(("nr", "ng")),
    3: make_axes(("R", "G", "B")),
}  # 0 to 1
DIMENSIONS = pytest.mark.parametrize("dimensions", PLANES)
RGB = PLANES[3]
HISTOGRAMS = {name for name in CLASSIFIERS if name.startswith("hist")}

every_classifier = pytest.mark.parametrize(
    "classifier", CLASSIFIERS.values(), ids=CLASSIFIERS.keys()
)
every_distance = pytest.mark.parametrize(
    "classifier",
    [classifier for name, classifier in CLASSIFIERS.items() if name not in HISTOGRAMS],
    ids=lambda classifier: classifier.name,
)


def words_of(annotation: Any) -> Iterator[str]:
    """Yield the strings that a setting allows, at any depth of its type."""
    for part in get_args(annotation):
        if isinstance(part, str):
            yield part
        else:
            yield from words_of(part)


def readings(*left_out: str) -> list[Any]:
    """Return every classifier with each alternative reading of the paper, one setting at a time.

    ``left_out`` names settings that do not matter. All other tests use the defaults.
    """
    return [
        pytest.param(classifier, {name: word}, id=f"{classifier.name}-{name}={word}")
        for classifier in CLASSIFIERS.values()
        for name, field in classifier.settings.model_fields.items()
        for word in words_of(field.annotation)
        if word != field.default and name not in left_out
    ]


@cache
def of_asphalt(classifier: Classifier) -> FittedClassifier:
    """Return a classifier fitted to ``asphalt()`` with default settings, cached."""
    return fit(classifier, asphalt(), RGB)


def fitted(
    classifier: Classifier, samples: Tensor, settings: ClassifierSettings | None = None
) -> FittedClassifier:
    """Return a classifier fitted to samples (m, d) of d planes."""
    return fit(classifier, samples, PLANES[samples.shape[1]], settings)


def rank_correlation(first: Tensor, second: Tensor) -> float:
    """Return Spearman's rank correlation of values without ties."""
    ranks = [values.argsort().argsort().double() for values in (first, second)]
    return float(torch.corrcoef(torch.stack(ranks))[0, 1])


def doubles(values: Tensor) -> np.ndarray:
    return values.double().numpy()


def some(number: int, dimensions: int, seed: int = 0, spread: float = 1.0) -> Tensor:
    """Return uniform samples (number, dimensions) in a box of side ``spread`` around 0.4."""
    return 0.4 + spread * (torch.rand(number, dimensions, generator=seeded_generator(seed)) - 0.4)


def road(number: int, dimensions: int, seed: int = 1, spread: float = 0.03) -> Tensor:
    """Return samples (number, dimensions) of a grey with some noise."""
    return 0.4 + spread * torch.randn(number, dimensions, generator=seeded_generator(seed))


def asphalt(count: int = 90, seed: int = 0) -> Tensor:
    return road(count, 3, seed, 0.02)


def around_red(count: int = 90) -> Tensor:
    """Return hues on both sides of red, where the circle begins and ends, with some saturation."""
    noise = road(count, 2, 0, 0.02)
    return torch.stack([(noise[:, 0] - 0.4).remainder(1), noise[:, 1]], 1)
