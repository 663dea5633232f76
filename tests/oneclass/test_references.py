"""Distances of classifiers with a closed form against loops over samples, bins and edges."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from roadtorch.oneclass import CLASSIFIERS
from tests.oneclass.cases import doubles, fitted, road, some
from tests.reference import oneclass_boundary, oneclass_density

ROUNDING = 1 / (12 * 255**2)
"""Variance of rounding to 256 levels, of planes from 0 to 1."""


@pytest.mark.parametrize(
    ("name", "settings", "reference"),
    [
        ("nn", {}, oneclass_boundary.nearest_distance),
        ("mst", {}, oneclass_boundary.tree_distance),
        ("kmeans", {"centres": 50}, oneclass_boundary.nearest_distance),
        ("kcentres", {"centres": 50}, oneclass_boundary.nearest_distance),
        ("gaussian", {}, partial(oneclass_density.gaussian_distance, floor=ROUNDING)),
        ("hist64_s", {}, partial(oneclass_density.histogram_distance, bins=64)),
        ("hist100_s", {}, partial(oneclass_density.histogram_distance, bins=100)),
        ("hist64_s", {"planes": "product"}, oneclass_density.histograms_distance),
        ("pca", {"variance": 0.0}, partial(oneclass_density.residual_distance, kept=0)),
        ("pca", {"variance": 0.95}, partial(oneclass_density.residual_distance, kept=-1)),
    ],
)
def test_the_distance_is_that_of_the_slow_version(
    name: str, settings: dict[str, Any], reference: Callable[..., np.ndarray]
) -> None:
    classifier = CLASSIFIERS[name]
    for dimensions in (2, 3) if classifier.single else (1, 2, 3):
        samples, pixels = road(40, dimensions), some(100, dimensions)
        # Twins change nothing where no variance is divided by m - 1.
        for given in [samples] if name in {"gaussian", "pca"} else [samples, samples.repeat(2, 1)]:
            learned = fitted(classifier, given, classifier.settings.model_validate(settings))

            expected = reference(doubles(given), doubles(pixels))
            np.testing.assert_allclose(learned.distance(pixels), expected, rtol=2e-5, atol=1e-6)
