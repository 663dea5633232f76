"""What all one-class classifiers share: axes, hue, thresholds, likelihoods, chunks."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.oneclass import base
from roadtorch.oneclass.axes import make_axes, mean_hues, unroll_hue
from roadtorch.oneclass.base import (
    Classifier,
    ClassifierSettings,
    DistanceModel,
    FittedClassifier,
    RoadSamples,
    fit,
    rejection_distance,
)
from tests.draws import random

PLANE = make_axes(("S",))


def middle_of(
    samples: Tensor,
    training: Tensor | None = None,
    threshold: float | None = None,
    rejected: float = 0.025,
) -> FittedClassifier:
    """Return a classifier by the distance to the mean of samples of one plane."""

    def fit_middle(road: RoadSamples, settings: ClassifierSettings) -> DistanceModel:
        middle = road.samples.mean(0).float()
        return DistanceModel(
            lambda pixels: (pixels - middle[:, None]).abs().amax(0), 2, training, threshold
        )

    middle = Classifier("middle", "distance to the middle", ClassifierSettings, fit_middle)
    return fit(middle, samples, PLANE, ClassifierSettings(rejected=rejected))


def line(*values: float) -> Tensor:
    return torch.tensor(values)[:, None]


FIVE = line(0.3, 0.4, 0.5, 0.6, 0.7)


# --- axes and hue ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hues", "saturations", "mean"),
    [
        ([0.9, 0.1], [0.5, 0.5], 0),
        ([0.6, 0.7], [0.5, 0.5], 0.65),
        ([0.0, 0.5], [0.5, 0.5], 0),  # they cancel
        ([0.3, 0.7, 0.7], [0.8, 0.0, 0.0], 0.3),  # saturated colours decide
        ([0.2, 0.4], [0.0, 0.0], 0.3),
    ],
)
def test_the_mean_hue_is_circular(hues: list[float], saturations: list[float], mean: float) -> None:
    means = mean_hues(torch.tensor([hues, saturations]), make_axes(("H", "S"))).tolist()

    assert means == pytest.approx([mean, 0], abs=1e-7)


def test_unrolled_hue_is_the_distance_along_the_circle() -> None:
    hues = torch.cat([random(200, dtype=torch.float32), torch.tensor([0, 0.5, 1])])
    for mean in (0.0, 0.25, 0.5, 0.99, 1.0):
        away = unroll_hue(hues, mean)

        along = (hues - mean).abs()
        assert away.abs().max() <= 0.5 + 1e-7
        expected = torch.minimum(along, (1 - along).abs())
        np.testing.assert_allclose(away.abs(), expected, atol=1e-6)


# --- thresholds and likelihoods ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("rejected", "boundary"), [(0, 8), (0.1, 8), (0.2, 6), (0.5, 3), (0.75, 1.5), (0.9, 1), (1, 1)]
)
def test_the_boundary_lies_between_the_samples(rejected: float, boundary: float) -> None:
    assert rejection_distance(np.array([4.0, 1.0, 8.0, 2.0]), rejected) == boundary
    assert rejection_distance(np.array([3.0]), rejected) == 3


def test_the_likelihood_is_a_half_at_the_threshold_and_falls_with_the_distance() -> None:
    likelihood = middle_of(FIVE, rejected=0.4).likelihood(line(0.5, 0.65, 1.1)).tolist()

    assert likelihood == pytest.approx([1, 1 / 2, 1 / 3], rel=1e-3)


@pytest.mark.parametrize(
    ("fitted", "threshold"),
    [
        (lambda: middle_of(FIVE, rejected=0.4), 0.15),
        (lambda: middle_of(FIVE, threshold=7.0), 7),
        (lambda: middle_of(FIVE, training=torch.tensor([1.0, 3.0]), rejected=0.5), 2),
        (lambda: middle_of(line(0.4, 0.4, 0.4)), 1 / 255),
    ],
    ids=["of the samples", "its own", "of what it gives", "one quantum for one colour"],
)
def test_where_the_threshold_comes_from(
    fitted: Callable[[], FittedClassifier], threshold: float
) -> None:
    assert float(fitted().threshold) == pytest.approx(threshold, rel=1e-4)


def test_memory_is_bounded_by_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = []

    def watched(pixels: Tensor) -> Tensor:
        sizes.append(pixels.shape[1])
        return pixels[0]

    watching = Classifier(
        "watching", "", ClassifierSettings, lambda *_: DistanceModel(watched, floats=2)
    )
    fitted = fit(watching, line(0.4, 0.5), PLANE)
    sizes.clear()
    monkeypatch.setattr(base, "CHUNK_FLOATS", 200)

    fitted.distance(torch.rand(1001, 1))

    assert max(sizes) <= 100
    assert sum(sizes) == 1001
