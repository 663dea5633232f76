"""Gaussians, mixtures and histograms: closed forms, bins, and how many components."""

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.base.errors import ConfigError
from roadtorch.imaging.color import PLANES as COLOR_PLANES
from roadtorch.oneclass import CLASSIFIERS, fit, make_axes
from roadtorch.oneclass.density import chi_quantile
from roadtorch.oneclass.histogram import HistogramSettings, add_noisy_copy, bin_indices
from roadtorch.oneclass.mixture import (
    MixtureSettings,
)
from tests.draws import random, seeded_generator
from tests.oneclass.cases import PLANES
from tests.reference import oneclass_density as reference


def correlated(planes: int, count: int = 90, seed: int = 0) -> Tensor:
    """Return correlated samples (count, planes), float64, around 0.4."""
    noise = torch.randn(count, planes, generator=seeded_generator(seed), dtype=torch.float64)
    mixing = random(planes, planes, seed=seed + 1)
    return 0.4 + 0.02 * noise @ (mixing + torch.eye(planes))


def test_quantiles_are_those_of_chi_square() -> None:
    assert chi_quantile(0.975, 3) ** 2 == pytest.approx(9.3484036)  # by its tables


# --- histograms -------------------------------------------------------------------------


SIMPLE = CLASSIFIERS["hist64_s"]


@pytest.mark.parametrize("bins", [64, 100])
@pytest.mark.parametrize("name", COLOR_PLANES)
def test_a_value_on_the_edge_of_two_bins_is_in_the_upper_one(name: str, bins: int) -> None:
    axes = make_axes((name,))
    edges = axes.low[0] + axes.span * torch.arange(bins, dtype=torch.float64) / bins
    pixels = edges.float()[None].nextafter(torch.tensor(-torch.inf))

    low, scale = torch.tensor(axes.low), (bins / axes.span).float()

    assert bin_indices(pixels, low, scale, bins).tolist() == [list(range(bins))]


def test_the_noisy_copy_has_p3s_deviation_and_is_dropped_or_wrapped_at_the_range() -> None:
    axes, samples = make_axes(("S", "O2")), torch.tensor([[0.5, 0.0]]).double().repeat(50_000, 1)
    edge = torch.full((1000, 1), 0.99, dtype=torch.float64)

    noisy = add_noisy_copy(samples, axes, 30 / 256, seeded_generator())
    dropped = add_noisy_copy(edge, make_axes(("S",)), 0.1, seeded_generator())
    wrapped = add_noisy_copy(edge, make_axes(("H",)), 0.1, seeded_generator())

    assert torch.equal(noisy[:50_000], samples)
    deviation = noisy[50_000:].std(0) / axes.span
    assert deviation.tolist() == pytest.approx([30 / 256, 30 / 256], rel=0.02)
    assert 1400 < len(dropped) < 1600
    assert dropped.max() <= 1
    assert len(wrapped) == 2000
    assert 0 <= wrapped.min() < 0.2


def test_too_many_bins_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"^bins: 400 bins in 3 dimensions are too many .use"):
        fit(SIMPLE, random(90, 3), make_axes(("R", "G", "B")), HistogramSettings(bins=400))


# --- mixtures -----------------------------------------------------------------------------


TWO, BEST = CLASSIFIERS["mog2"], CLASSIFIERS["mog_opt"]
AXES = PLANES[2]
POINTS = random(200, 2, seed=1, dtype=torch.float32) - 0.5


def clusters(number: int, count: int = 120) -> Tensor:
    """Return samples (count, 2), float64, in round clusters on a circle, mean 0."""
    angle = 2 * torch.pi * torch.arange(number, dtype=torch.float64) / number
    middles = 0.3 * torch.stack([angle.cos(), angle.sin()], 1)
    noise = torch.randn(count, 2, generator=seeded_generator(), dtype=torch.float64)
    return (middles.repeat(-(-count // number), 1)[:count] if number > 1 else 0) + 0.03 * noise


@pytest.mark.parametrize("formula", ["density", "paper"])
def test_the_distance_is_that_of_the_density_or_of_the_papers_formula(formula: str) -> None:
    samples = torch.cat([clusters(1), 0.2 * clusters(1) + 0.4])
    settings = MixtureSettings.model_validate({"formula": formula})

    distance = fit(TWO, samples, AXES, settings).distance(POINTS)

    centred = samples - samples.mean(0)
    widening = torch.diag(0.01 * centred.square().mean() + AXES.quantum.square() / 12).numpy()
    heaps = samples.view(2, 120, 2).numpy()  # far apart: each has its component
    means = heaps.mean(1)
    spread = np.stack([np.cov(heap.T, bias=True) + widening for heap in heaps])
    if formula == "density":
        logs = reference.log_densities(POINTS.numpy(), np.ones(2), means, spread)
        peaks = reference.log_densities(means, np.ones(2), means, spread).diagonal()
    else:  # no 1/2 in the exponent and no determinants
        logs = -reference.squared_distances(POINTS.numpy(), means, spread)
        peaks = np.zeros(2)
    expected = reference.log_sum(logs) - reference.log_sum(peaks)
    np.testing.assert_allclose(distance, np.sqrt(-2 * expected), rtol=1e-3)


# --- how many ---------------------------------------------------------------------------


@pytest.mark.parametrize("number", [1, 2, 3, 5])
def test_the_criterion_finds_the_number_of_clusters(number: int) -> None:
    floats = fit(BEST, clusters(number), AXES).model.floats

    assert floats == 6 * number  # in two planes each component takes six numbers a pixel
