"""The Gaussian and the robust one: closed forms and outliers; histograms."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.base.errors import ConfigError
from roadtorch.oneclass import CLASSIFIERS, axes_of, fit
from roadtorch.oneclass.density import (
    GaussianSettings,
    RobustSettings,
    chi_quantile,
    moments,
    reweighted,
)
from roadtorch.oneclass.histogram import HistogramSettings, with_noisy_copy
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


# --- histograms -------------------------------------------------------------------------


SIMPLE = CLASSIFIERS["hist64_s"]


def test_distance_zero_is_the_fullest_bin_and_an_empty_one_is_infinitely_far() -> None:
    samples = torch.tensor([[0.1], [0.5], [0.5], [0.5], [0.9]])
    fitted = fit(SIMPLE, samples, axes_of(("S",)))

    found = fitted.distance(torch.tensor([[0.5], [0.1], [0.3]]))

    assert found.tolist() == pytest.approx([0, (2 * np.log(3)) ** 0.5, np.inf])
    assert fitted.likelihood(torch.tensor([[0.3]])) == 0


def test_the_noisy_copy_has_the_deviation_of_p3_in_ranges_of_the_plane() -> None:
    axes, samples = axes_of(("S", "O2")), torch.tensor([[0.5, 0.0]]).double().repeat(50_000, 1)

    both = with_noisy_copy(samples, axes, 30 / 256, "clip", seeded())

    assert both.shape == (100_000, 2)
    assert torch.equal(both[:50_000], samples)
    deviation = both[50_000:].std(0) / axes.span
    assert deviation.tolist() == pytest.approx([30 / 256, 30 / 256], rel=0.02)


def test_noisy_samples_beyond_the_range_are_dropped_clipped_or_wrapped() -> None:
    samples = torch.full((1000, 1), 0.99, dtype=torch.float64)

    dropped = with_noisy_copy(samples, axes_of(("S",)), 0.1, "drop", seeded())
    wrapped = with_noisy_copy(samples, axes_of(("H",)), 0.1, "drop", seeded())

    assert 1400 < len(dropped) < 1600
    assert dropped.max() <= 1
    assert len(wrapped) == 2000
    assert 0 <= wrapped.min() < 0.2


def test_too_many_bins_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"^bins: 400 bins in 3 dimensions are too many .use"):
        fit(SIMPLE, random(90, 3), axes_of(("R", "G", "B")), HistogramSettings(bins=400))
