"""Mixtures of Gaussians: SciPy's density, scikit-learn's fit, and how many there are."""

from typing import get_args

import numpy as np
import pytest
import torch
from sklearn.mixture import GaussianMixture
from torch import Tensor

from roadtorch.oneclass import CLASSIFIERS, Fitted, axes_of, fit
from roadtorch.oneclass.mixture import (
    BestMixtureSettings,
    Mixtures,
    MixtureSettings,
    log_density,
    maximise,
    mixtures_of,
    parameters,
    spread_starts,
)
from tests.draws import seeded
from tests.oneclass.cases import kept
from tests.reference import oneclass_density as reference

TWO, FOUR, BEST = (CLASSIFIERS[name] for name in ("mog2", "mog4", "mog_opt"))
SELECT = get_args(BestMixtureSettings.model_fields["select"].annotation)
WIDENING = torch.full((2,), 1e-5, dtype=torch.float64)
AXES = axes_of(("O1", "O2"))


def clusters(number: int, count: int = 120, seed: int = 0) -> Tensor:
    """Samples (count,2) float64 in some round heaps on a circle, mean 0."""
    angle = 2 * torch.pi * torch.arange(number, dtype=torch.float64) / number
    middles = 0.3 * torch.stack([angle.cos(), angle.sin()], 1)
    noise = torch.randn(count, 2, generator=seeded(seed), dtype=torch.float64)
    return (middles.repeat(-(-count // number), 1)[:count] if number > 1 else 0) + 0.03 * noise


def memberships(samples: Tensor, number: int) -> Tensor:
    weights = samples.new_ones(1, len(samples))
    return spread_starts(samples, weights, torch.tensor([number]), seeded())


def parts_of(fitted: Fitted) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Logarithms of the weights (N,), means (N,d) and whitening (N,d,d) of a fitted mixture."""
    log_weights, whiten, offsets = (
        kept(fitted, name).double() for name in ("log_weights", "whiten", "offsets")
    )
    means = -torch.linalg.solve(whiten, offsets.view(*whiten.shape[:2], 1))[..., 0]
    return log_weights.numpy(), means.numpy(), whiten.numpy()


def covariances(mixtures: Mixtures) -> np.ndarray:
    return torch.linalg.inv(mixtures.whitening.mT @ mixtures.whitening)[0].numpy()


# --- density ----------------------------------------------------------------------------


@pytest.mark.parametrize("planes", [1, 2, 3])
def test_the_density_is_scipys(planes: int) -> None:
    samples = 0.1 * torch.randn(60, planes, generator=seeded(), dtype=torch.float64)
    mixtures = mixtures_of(samples, memberships(samples, 3), WIDENING[:1].expand(planes))
    points = torch.randn(40, planes, generator=seeded(1), dtype=torch.float64)

    found = log_density(points, mixtures)[0]

    expected = reference.mixture_log_density(
        points.numpy(),
        mixtures.log_shares[0].exp().numpy(),
        mixtures.means[0].numpy(),
        covariances(mixtures),
    )
    np.testing.assert_allclose(found, expected, rtol=1e-8)


@pytest.mark.parametrize("name", ["mog2", "mog4"])
def test_the_distance_is_that_of_the_density_from_its_peak(name: str) -> None:
    fitted = fit(CLASSIFIERS[name], clusters(2), AXES)
    points = torch.rand(200, 2, generator=seeded(1)) - 0.5
    log_weights, means, matrices = parts_of(fitted)

    found = fitted.distance(points).double().numpy()

    squared = [
        np.square((points.double().numpy() - mean) @ matrix.T).sum(1)
        for mean, matrix in zip(means, matrices, strict=True)
    ]
    log = reference.log_sum(log_weights[:, None] - np.stack(squared) / 2)
    np.testing.assert_allclose(found, np.sqrt(-2 * log), rtol=1e-4)
    assert np.isclose(reference.log_sum(log_weights), 0, atol=1e-6)


def test_one_component_is_the_gaussian() -> None:
    samples, points = clusters(1), torch.rand(200, 2, generator=seeded(1)) - 0.5

    mixture = fit(TWO, samples, AXES, MixtureSettings(components=1)).distance(points)
    gaussian = fit(CLASSIFIERS["gaussian"], samples, AXES).distance(points)

    torch.testing.assert_close(mixture, gaussian, rtol=0.02, atol=0)  # other divisors and floors


def test_the_papers_formula_has_neither_half_nor_determinants() -> None:
    samples = torch.cat([clusters(1), 0.2 * clusters(1) + 0.4])
    point = torch.tensor([[0.1, 0.3]])

    complete = fit(TWO, samples, AXES)
    printed = fit(TWO, samples, AXES, MixtureSettings(formula="paper"))

    log_weights, means, matrices = parts_of(printed)
    weights = np.exp(log_weights)
    np.testing.assert_allclose(weights, [0.5, 0.5], atol=0.01)
    squared = [
        float(np.square((point.double().numpy() - mean) @ matrix.T).sum()) / 2  # W is W·√2 here
        for mean, matrix in zip(means, matrices, strict=True)
    ]
    expected = np.sqrt(-2 * reference.log_sum(np.log(weights) - np.array(squared)))
    assert float(printed.distance(point)) == pytest.approx(expected, rel=1e-4)
    assert not np.allclose(np.exp(parts_of(complete)[0]), weights, atol=0.1)


# --- fit --------------------------------------------------------------------------------


def test_every_round_is_the_textbooks() -> None:
    samples, start = clusters(3), memberships(clusters(3), 3)
    weights = samples.new_ones(1, len(samples))

    shares, _ = maximise(samples, weights, start, WIDENING, rounds=4)
    found = mixtures_of(samples, shares, WIDENING)

    expected = reference.expectation_maximisation(
        samples.numpy(), start[0].numpy(), WIDENING.numpy(), rounds=5
    )
    np.testing.assert_allclose(found.log_shares[0].exp(), expected[0], rtol=1e-6)
    np.testing.assert_allclose(found.means[0], expected[1], atol=1e-8)
    np.testing.assert_allclose(covariances(found), expected[2], rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("number", [2, 4])
def test_the_likelihood_is_scikit_learns_from_the_same_start(number: int) -> None:
    samples = clusters(number)
    start = memberships(samples, number)
    weights = samples.new_ones(1, len(samples))

    _, likelihood = maximise(samples, weights, start, WIDENING, rounds=500)

    means = (start[0] @ samples / start[0].sum(1, keepdim=True)).numpy()
    peer = GaussianMixture(
        number, means_init=means, reg_covar=1e-5, tol=1e-8, max_iter=500, random_state=0
    ).fit(samples.numpy())
    expected = peer.score(samples.numpy()) * len(samples)
    assert float(likelihood) == pytest.approx(expected, rel=1e-3)


def test_runs_side_by_side_do_not_touch_each_other() -> None:
    samples = clusters(3)
    weights = samples.new_ones(2, len(samples))
    weights[1, ::2] = 0  # the second run sees every other sample
    alone = weights[1:, 1::2]
    two = torch.tensor([3, 2])
    start = spread_starts(samples, weights, two, seeded())

    both, _ = maximise(samples, weights, start, WIDENING, rounds=9)
    one, _ = maximise(samples[1::2], alone, start[1:, :, 1::2], WIDENING, rounds=9)

    torch.testing.assert_close(both[1:, :, 1::2], one)
    assert (both[1, 2] == 0).all()


def test_starts_are_spread_over_the_heaps() -> None:
    samples = clusters(4)
    weights = samples.new_ones(50, len(samples))

    start = spread_starts(samples, weights, torch.full((50,), 4), seeded())

    heaps = start[:, :, torch.arange(4)].sum(-1)  # the first four samples are of four heaps
    assert (heaps == 1).all(1).float().mean() > 0.8
    assert torch.equal(start.sum(1), weights)


# --- how many ---------------------------------------------------------------------------


def components(number: int, select: str, **more: object) -> int:
    settings = BEST.settings.model_validate({"select": select, **more})
    log_weights = kept(fit(BEST, clusters(number), AXES, settings), "log_weights")
    assert log_weights.isfinite().all()  # those that a run does not have are left out
    return len(log_weights)


@pytest.mark.parametrize("number", [1, 2, 3, 5])
def test_the_information_criterion_finds_the_number_of_heaps(number: int) -> None:
    assert components(number, "bic") == number


@pytest.mark.parametrize("select", ["aic", "cv"])
@pytest.mark.parametrize("number", [2, 3])
def test_the_other_criteria_find_at_least_the_heaps(number: int, select: str) -> None:
    assert number <= components(number, select) <= 6


def test_consistency_goes_on_while_held_out_samples_are_accepted() -> None:
    assert components(3, "consistent", rejected=1.0) == 6
    assert components(3, "consistent", components=4, rejected=1.0) == 4
    assert 1 <= components(3, "consistent") <= 6


def test_a_full_covariance_has_its_numbers_counted() -> None:
    assert parameters(torch.tensor([1, 2]), 3).tolist() == [9, 19]
    assert parameters(torch.tensor([1, 3]), 1).tolist() == [2, 8]


@pytest.mark.parametrize("select", SELECT)
@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_samples_have_few_components(count: int, select: str) -> None:
    settings = BEST.settings.model_validate({"select": select})

    fitted = fit(BEST, clusters(3)[:count], AXES, settings)

    assert 1 <= len(kept(fitted, "log_weights")) <= count
    assert fitted.likelihood(clusters(3).float()).isfinite().all()
