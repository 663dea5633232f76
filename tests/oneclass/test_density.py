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


def test_the_threshold_may_be_what_a_gaussian_rejects() -> None:
    fitted = fit(GAUSSIAN, correlated(2), PLANES[2], GaussianSettings(threshold="chi2"))

    assert float(fitted.threshold) == pytest.approx((-2 * math.log(0.025)) ** 0.5)
    assert chi_quantile(0.975, 3) ** 2 == pytest.approx(9.3484036)  # tables of chi-square


# --- robust -----------------------------------------------------------------------------------


@DIMENSIONS
def test_a_tenth_of_outliers_moves_the_robust_mean_five_times_less(dimensions: int) -> None:
    clean, axes = correlated(dimensions), PLANES[dimensions]
    spoilt = clean.clone()
    spoilt[:9] = 0.9 + 0.02 * random(9, dimensions)  # white paint

    robust, plain = (
        [reweighted(each, axes, RobustSettings(), power=1.5)[0] for each in (clean, spoilt)],
        [moments(each)[0] for each in (clean, spoilt)],
    )

    assert (robust[0] - robust[1]).norm() * 5 < (plain[0] - plain[1]).norm()


@DIMENSIONS
@pytest.mark.parametrize("method", ["reweighted", "huber"])
def test_clean_samples_give_nearly_the_gaussian(dimensions: int, method: str) -> None:
    samples, axes = correlated(dimensions, 1000), PLANES[dimensions]
    settings = ROBUST.settings.model_validate({"method": method})

    plain, robust = fit(GAUSSIAN, samples, axes), fit(ROBUST, samples, axes, settings)

    seen = random(300, dimensions, seed=9, dtype=torch.float32)
    assert rank_correlation(plain.distance(seen), robust.distance(seen)) > 0.99


def test_weights_are_those_of_the_docstring_at_the_end() -> None:
    samples, axes = correlated(2), PLANES[2]
    settings = RobustSettings(ridge=0.0)

    mean, covariance = reweighted(samples, axes, settings, power=1)

    distance = ((samples - mean) @ torch.linalg.inv(covariance) * (samples - mean)).sum(1).sqrt()
    weights = ((-2 * math.log(0.025)) ** 0.5 / distance).clamp_max(1)
    np.testing.assert_allclose(mean, (weights @ samples) / weights.sum(), atol=1e-6)
