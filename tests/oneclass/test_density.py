"""The Gaussian and the robust Gaussian: closed forms and outliers."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.oneclass import CLASSIFIERS, fit
from roadtorch.oneclass.density import (
    GaussianSettings,
    RobustSettings,
    chi_quantile,
    floor_of,
    moments,
    reweighted,
)
from tests.draws import random, seeded
from tests.oneclass.cases import DIMENSIONS, PLANES, rank_correlation

GAUSSIAN, ROBUST = CLASSIFIERS["gaussian"], CLASSIFIERS["robust_gaussian"]


def correlated(planes: int, count: int = 90, seed: int = 0) -> Tensor:
    """Samples (count,planes) float64 about 0.4 that vary together."""
    noise = torch.randn(count, planes, generator=seeded(seed), dtype=torch.float64)
    mixing = random(planes, planes, seed=seed + 1)
    return 0.4 + 0.02 * noise @ (mixing + torch.eye(planes))


def planted(planes: int, share: float, seed: int = 0, count: int = 90) -> tuple[Tensor, Tensor]:
    """Samples, and the same with a share of them replaced by white paint."""
    clean = correlated(planes, count, seed)
    spoilt = clean.clone()
    paint = random(round(share * count), planes, seed=seed)
    spoilt[: len(paint)] = 0.9 + 0.02 * paint
    return clean, spoilt


def pixels(planes: int) -> Tensor:
    return random(300, planes, seed=9, dtype=torch.float32)


def test_the_floor_of_variance_is_that_of_rounding_to_256_levels() -> None:
    levels = random(100_000)
    error = (levels * 255).round() / 255 - levels

    expected = float(error.square().mean())
    assert floor_of(PLANES[3]).tolist() == pytest.approx([expected] * 3, rel=0.02)


def test_the_threshold_may_be_what_a_gaussian_rejects() -> None:
    fitted = fit(GAUSSIAN, correlated(2), PLANES[2], GaussianSettings(threshold="chi2"))

    assert float(fitted.threshold) == pytest.approx((-2 * math.log(0.025)) ** 0.5)
    assert chi_quantile(0.975, 3) ** 2 == pytest.approx(9.3484036)  # tables of chi-square


# --- robust -----------------------------------------------------------------------------------


@DIMENSIONS
@pytest.mark.parametrize("seed", range(2))
def test_a_tenth_of_outliers_moves_the_robust_mean_five_times_less(
    dimensions: int, seed: int
) -> None:
    both = planted(dimensions, 0.1, seed)

    robust, plain = (
        [
            reweighted(samples, PLANES[dimensions], RobustSettings(), power=1.5)[0]
            for samples in both
        ],
        [moments(samples)[0] for samples in both],
    )

    assert (robust[0] - robust[1]).norm() * 5 < (plain[0] - plain[1]).norm()


@DIMENSIONS
@pytest.mark.parametrize("method", ["reweighted", "huber"])
def test_clean_samples_give_nearly_the_gaussian(dimensions: int, method: str) -> None:
    samples, axes = correlated(dimensions, 1000), PLANES[dimensions]
    settings = ROBUST.settings.model_validate({"method": method})

    plain, robust = fit(GAUSSIAN, samples, axes), fit(ROBUST, samples, axes, settings)

    seen = pixels(dimensions)
    assert rank_correlation(plain.distance(seen), robust.distance(seen)) > 0.99


def test_weights_are_those_of_the_docstring_at_the_end() -> None:
    samples, axes = correlated(2), PLANES[2]
    settings = RobustSettings(ridge=0.0)

    mean, covariance = reweighted(samples, axes, settings, power=1)

    distance = ((samples - mean) @ torch.linalg.inv(covariance) * (samples - mean)).sum(1).sqrt()
    weights = ((-2 * math.log(0.025)) ** 0.5 / distance).clamp_max(1)
    np.testing.assert_allclose(mean, (weights @ samples) / weights.sum(), atol=1e-6)
