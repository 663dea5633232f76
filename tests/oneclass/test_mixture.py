"""Mixtures of Gaussians: their density, expectation maximisation, and how many there are."""

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.oneclass import CLASSIFIERS, Fitted, fit
from roadtorch.oneclass.mixture import (
    Mixtures,
    MixtureSettings,
    _powers,
    log_parts,
    maximise,
    mixtures_of,
    spread_starts,
)
from tests.draws import random, seeded
from tests.oneclass.cases import DIMENSIONS, PLANES
from tests.reference import oneclass_density as reference

TWO, BEST = CLASSIFIERS["mog2"], CLASSIFIERS["mog_opt"]
WIDENING = torch.full((2,), 1e-5, dtype=torch.float64)
AXES = PLANES[2]
POINTS = random(200, 2, seed=1, dtype=torch.float32) - 0.5


def clusters(number: int, count: int = 120) -> Tensor:
    """Samples (count,2) float64 in some round heaps on a circle, mean 0."""
    angle = 2 * torch.pi * torch.arange(number, dtype=torch.float64) / number
    middles = 0.3 * torch.stack([angle.cos(), angle.sin()], 1)
    noise = torch.randn(count, 2, generator=seeded(), dtype=torch.float64)
    return (middles.repeat(-(-count // number), 1)[:count] if number > 1 else 0) + 0.03 * noise


def memberships(samples: Tensor, number: int) -> Tensor:
    weights = samples.new_ones(1, len(samples))
    return spread_starts(samples, weights, torch.tensor([number]), seeded())


def components(fitted: Fitted) -> int:
    """How many a mixture in two planes scores with: each takes six numbers a pixel."""
    return fitted.learned.floats // 6


def parts_of(mixtures: Mixtures) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shares (N,), means (N,d) and covariances (N,d,d) of the only mixture."""
    covariances = torch.linalg.inv(mixtures.whitening.mT @ mixtures.whitening)
    return mixtures.log_shares[0].exp().numpy(), mixtures.means[0].numpy(), covariances[0].numpy()


# --- density ----------------------------------------------------------------------------


@DIMENSIONS
def test_the_density_is_the_sum_of_its_gaussians(dimensions: int) -> None:
    samples = 0.1 * torch.randn(60, dimensions, generator=seeded(), dtype=torch.float64)
    mixtures = mixtures_of(samples, memberships(samples, 3), WIDENING[:1].expand(dimensions))
    points = torch.randn(40, dimensions, generator=seeded(1), dtype=torch.float64)

    found = log_parts(_powers(points), mixtures).logsumexp(1)[0]

    expected = reference.log_sum(reference.log_parts(points.numpy(), *parts_of(mixtures)))
    np.testing.assert_allclose(found, expected, rtol=1e-8)


@pytest.mark.parametrize("formula", ["density", "paper"])
def test_the_distance_is_that_of_the_density_or_of_the_papers_formula_from_the_peaks(
    formula: str,
) -> None:
    samples = torch.cat([clusters(1), 0.2 * clusters(1) + 0.4])
    settings = MixtureSettings.model_validate({"formula": formula})

    found = fit(TWO, samples, AXES, settings).distance(POINTS)

    centred = samples - samples.mean(0)
    widening = torch.diag(0.01 * centred.square().mean() + AXES.quantum.square() / 12).numpy()
    heaps = samples.view(2, 120, 2).numpy()  # far apart: each has its component
    means = heaps.mean(1)
    spread = np.stack([np.cov(heap.T, bias=True) + widening for heap in heaps])
    if formula == "density":
        logs = reference.log_parts(POINTS.numpy(), np.ones(2), means, spread)
        peaks = reference.log_parts(means, np.ones(2), means, spread).diagonal()
    else:  # no 1/2 in the exponent and no determinants
        logs = -reference.squared_distances(POINTS.numpy(), means, spread)
        peaks = np.zeros(2)
    expected = reference.log_sum(logs) - reference.log_sum(peaks)
    np.testing.assert_allclose(found, np.sqrt(-2 * expected), rtol=1e-3)


# --- fit --------------------------------------------------------------------------------


def test_every_round_is_the_textbooks() -> None:
    samples, start = clusters(3), memberships(clusters(3), 3)
    weights = samples.new_ones(1, len(samples))

    shares, _ = maximise(samples, weights, start, WIDENING, rounds=4)
    found = parts_of(mixtures_of(samples, shares, WIDENING))

    expected = reference.expectation_maximisation(
        samples.numpy(), start[0].numpy(), WIDENING.numpy(), rounds=5
    )
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-6)
    np.testing.assert_allclose(found[1], expected[1], atol=1e-8)
    np.testing.assert_allclose(found[2], expected[2], rtol=1e-5, atol=1e-9)


# --- how many ---------------------------------------------------------------------------


@pytest.mark.parametrize("number", [1, 2, 3, 5])
def test_the_criterion_finds_the_heaps(number: int) -> None:
    assert components(fit(BEST, clusters(number), AXES)) == number
