"""The Gaussian and the robust Gaussian: closed forms, peers, and outliers."""

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist
from scipy.stats import chi2
from sklearn.covariance import MinCovDet
from torch import Tensor

from roadtorch.oneclass import CLASSIFIERS, axes_of, fit
from roadtorch.oneclass.density import (
    GaussianSettings,
    RobustSettings,
    concentrated,
    floor_of,
    least_determinant,
    moments,
    reweighted,
    tyler,
    whitening,
)
from tests.draws import seeded
from tests.oneclass.cases import kept
from tests.reference import oneclass_density as reference

GAUSSIAN, ROBUST = CLASSIFIERS["gaussian"], CLASSIFIERS["robust_gaussian"]
PLANES = {1: axes_of(("S",)), 2: axes_of(("O1", "O2")), 3: axes_of(("R", "G", "B"))}


def correlated(planes: int, count: int = 90, seed: int = 0) -> Tensor:
    """Samples (count,planes) float64 about 0.4 that vary together."""
    noise = torch.randn(count, planes, generator=seeded(seed), dtype=torch.float64)
    mixing = torch.rand(planes, planes, generator=seeded(seed + 1), dtype=torch.float64)
    return 0.4 + 0.02 * noise @ (mixing + torch.eye(planes))


def pixels(planes: int) -> Tensor:
    return torch.rand(300, planes, generator=seeded(9))


@pytest.mark.parametrize("planes", PLANES)
def test_the_gaussian_is_scipys_mahalanobis_distance(planes: int) -> None:
    samples, axes = correlated(planes).float(), PLANES[planes]

    found = fit(GAUSSIAN, samples, axes).distance(pixels(planes))

    own = samples.double().numpy()
    covariance = reference.gaussian_covariance(own, 1e-3, floor_of(axes).numpy())
    expected = cdist(
        pixels(planes).double(), own.mean(0)[None], "mahalanobis", VI=np.linalg.inv(covariance)
    )
    np.testing.assert_allclose(found, expected[:, 0], rtol=2e-5)


def test_the_floor_of_variance_is_that_of_rounding_to_256_levels() -> None:
    levels = torch.rand(100_000, generator=seeded(), dtype=torch.float64)
    error = (levels * 255).round() / 255 - levels

    assert float(floor_of(PLANES[1])) == pytest.approx(float(error.square().mean()), rel=0.02)


def test_the_threshold_may_be_what_a_gaussian_rejects() -> None:
    fitted = fit(GAUSSIAN, correlated(3), PLANES[3], GaussianSettings(threshold="chi2"))

    assert float(fitted.threshold) == pytest.approx(chi2.ppf(0.975, 3) ** 0.5)


# --- robust -----------------------------------------------------------------------------------


def planted(planes: int, share: float, seed: int) -> tuple[Tensor, Tensor]:
    """Samples, and the same with a share of them replaced by white paint."""
    clean = correlated(planes, seed=seed)
    spoilt = clean.clone()
    count = round(share * len(clean))
    paint = torch.rand(count, planes, generator=seeded(seed), dtype=torch.float64)
    spoilt[:count] = 0.9 + 0.02 * paint
    return clean, spoilt


@pytest.mark.parametrize("planes", PLANES)
@pytest.mark.parametrize("seed", range(2))
def test_a_tenth_of_outliers_moves_the_robust_mean_five_times_less(planes: int, seed: int) -> None:
    clean, spoilt = planted(planes, 0.1, seed)

    def moved(name: str) -> float:
        one, two = (fit(CLASSIFIERS[name], samples, PLANES[planes]) for samples in (clean, spoilt))
        means = [
            -torch.linalg.solve(kept(fitted, "whitening"), kept(fitted, "offset"))
            for fitted in (one, two)
        ]
        return float((means[0] - means[1]).norm())

    assert moved("robust_gaussian") * 5 < moved("gaussian")


@pytest.mark.parametrize("planes", PLANES)
@pytest.mark.parametrize("method", ["reweighted", "huber", "trim", "mcd", "tyler"])
def test_clean_samples_give_nearly_the_gaussian(planes: int, method: str) -> None:
    samples, axes = correlated(planes, 2000), PLANES[planes]
    settings = ROBUST.settings.model_validate({"method": method})

    plain, robust = fit(GAUSSIAN, samples, axes), fit(ROBUST, samples, axes, settings)

    ranks = [
        fitted.distance(pixels(planes)).argsort().argsort().double() for fitted in (plain, robust)
    ]
    assert torch.corrcoef(torch.stack(ranks))[0, 1] > 0.99


def test_weights_are_those_of_the_docstring_at_the_end() -> None:
    samples, axes = correlated(2), PLANES[2]
    settings = RobustSettings(ridge=0.0)

    mean, covariance = reweighted(samples, axes, settings, power=1)

    distance = ((samples - mean) @ torch.linalg.inv(covariance) * (samples - mean)).sum(1).sqrt()
    weights = (chi2.ppf(0.975, 2) ** 0.5 / distance).clamp_max(1)
    torch.testing.assert_close(mean, (weights @ samples) / weights.sum(), atol=1e-6, rtol=0)


@pytest.mark.parametrize("share", [0.1, 0.25])
def test_the_least_determinant_is_no_larger_than_scikit_learns(share: float) -> None:
    _, samples = planted(3, share - 0.02, seed=3)
    settings = RobustSettings(rejected=share, ridge=0.0)

    mean, covariance = least_determinant(samples, PLANES[3], settings, seeded())

    peer = MinCovDet(support_fraction=1 - share, random_state=0).fit(samples.numpy())
    theirs = moments(samples[torch.from_numpy(peer.raw_support_)])[1]
    assert torch.logdet(covariance) < torch.logdet(theirs) + 0.05
    if share == 0.1:  # at a quarter scikit-learn ends in a worse optimum, among the outliers
        np.testing.assert_allclose(mean, peer.raw_location_, atol=1e-6)


def test_concentration_ends_with_the_samples_nearest_to_their_own_mean() -> None:
    _, samples = planted(2, 0.1, seed=0)
    settings = RobustSettings(rejected=0.1)

    mean, covariance = concentrated(samples, PLANES[2], settings, torch.arange(90))

    distance = ((samples - mean) @ whitening(covariance).T).norm(dim=1)
    nearest = distance.argsort()[:81]
    torch.testing.assert_close(mean, samples[nearest].mean(0))


def test_tylers_scatter_is_the_identity_in_its_own_coordinates() -> None:
    samples = 10 * correlated(3)  # beside which rounding is nothing

    mean, factor = tyler(samples, PLANES[3], RobustSettings())

    seen = (samples - mean) @ factor
    weights = 1 / seen.square().sum(1)
    scatter = seen.T @ (weights[:, None] * seen) / weights.sum()
    torch.testing.assert_close(scatter, torch.eye(3, dtype=torch.float64), atol=3e-3, rtol=0)


def test_the_toolboxs_mistake_shows_in_several_planes_only() -> None:
    def distances(planes: int, method: str) -> Tensor:
        settings = ROBUST.settings.model_validate({"method": method})
        return fit(ROBUST, correlated(planes), PLANES[planes], settings).distance(pixels(planes))

    torch.testing.assert_close(distances(1, "tyler"), distances(1, "tyler-vtv"))
    assert not torch.allclose(distances(3, "tyler"), distances(3, "tyler-vtv"), rtol=0.1)
