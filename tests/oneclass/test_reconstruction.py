"""Principal components, k-means and k-centres: scikit-learn, exhaustive search, closed forms."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.cluster import KMeans
from sklearn.decomposition import PCA
from torch import Tensor

from roadtorch.oneclass import CLASSIFIERS, axes_of, fit
from roadtorch.oneclass.reconstruction import (
    ComponentSettings,
    farthest_first,
    k_centres,
    k_means,
    kept_components,
)
from tests.oneclass.cases import kept
from tests.reference import oneclass_density as reference

COMPONENTS, MEANS, CENTRES, NEAREST = (
    CLASSIFIERS[name] for name in ("pca", "kmeans", "kcentres", "nn")
)
RGB = axes_of(("R", "G", "B"))


def flat_samples(seed: int = 0, count: int = 90) -> Tensor:
    """Samples (count,3) with nearly all of their variance in two directions."""
    generator = torch.Generator().manual_seed(seed)
    directions = torch.linalg.qr(torch.randn(3, 3, generator=generator)).Q
    spread = torch.tensor([0.1, 0.05, 0.005])
    return 0.5 + torch.randn(count, 3, generator=generator) * spread @ directions


def colours(count: int = 300) -> Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(7))


def points(count: int, planes: int = 2, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(count, planes, generator=generator, dtype=torch.float64)


# --- principal components ---------------------------------------------------------------


@pytest.mark.parametrize(("variance", "kept"), [(0.95, 2), (0.5, 1), (0.0, 0)])
def test_the_residual_is_scikit_learns(variance: float, kept: int) -> None:
    samples, pixels = flat_samples(), colours()

    found = fit(COMPONENTS, samples, RGB, ComponentSettings(variance=variance)).distance(pixels)

    if kept:
        peer = PCA(kept).fit(samples.double().numpy())
        back = peer.inverse_transform(peer.transform(pixels.double().numpy()))
    else:
        back = samples.double().numpy().mean(0)
    expected = np.linalg.norm(pixels.double().numpy() - back, axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_components_are_kept_until_they_have_the_share() -> None:
    variances = torch.tensor([0.9, 0.05, 0.05], dtype=torch.float64)

    assert [kept_components(variances, share) for share in (0.5, 0.95, 0.951, 1.0)] == [1, 2, 3, 3]
    assert kept_components(torch.zeros(3), 0.95) == 0


def test_where_all_components_are_needed_one_less_is_kept_or_none_or_nothing_is_lost() -> None:
    samples = torch.tensor([[0.6, 0.5], [0.4, 0.5], [0.5, 0.55], [0.5, 0.45]])
    axes, pixel = axes_of(("a", "b")), torch.tensor([[0.8, 0.9]])

    def distance(full: str) -> float:
        settings = ComponentSettings.model_validate({"full": full})
        return float(fit(COMPONENTS, samples, axes, settings).distance(pixel))

    assert distance("cap") == pytest.approx(0.4, rel=1e-5)
    assert distance("mean") == pytest.approx(0.5, rel=1e-5)
    assert distance("strict") == 0


# --- k-means ----------------------------------------------------------------------------


@pytest.mark.parametrize("number", [1, 3, 5])
def test_the_inertia_is_scikit_learns_from_the_same_start(number: int) -> None:
    samples = points(90, 3)

    centres, inertia = k_means(samples, samples[None, :number])

    options: dict = {"init": samples[:number].numpy(), "n_init": 1, "tol": 0}
    peer: Any = KMeans(number, **options).fit(samples.numpy())
    assert float(inertia) == pytest.approx(peer.inertia_)
    expected = peer.cluster_centers_
    np.testing.assert_allclose(np.sort(centres[0], 0), np.sort(expected, 0), atol=1e-6)


def test_restarts_are_as_good_as_scikit_learns() -> None:
    samples = points(90, 3)
    options: dict = {"n_init": 10, "random_state": 0}
    peer: Any = KMeans(5, **options).fit(samples.numpy())

    centres = kept(fit(MEANS, samples.float(), RGB), "centres").double()

    inertia = torch.cdist(samples, centres).square().amin(1).sum()
    assert float(inertia) < 1.02 * peer.inertia_


def test_a_centre_that_loses_its_samples_goes_where_it_is_needed() -> None:
    samples = torch.tensor([[0.0], [0.1], [1.0]], dtype=torch.float64)

    centres, inertia = k_means(samples, torch.tensor([[[0.05], [9.0], [8.0]]]).double())

    assert float(inertia) < 0.006
    assert 1.0 in centres[0].flatten().tolist()


# --- k-centres --------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.integers(0, 999), st.integers(4, 12), st.integers(1, 3))
def test_the_radius_is_at_most_twice_the_least(seed: int, count: int, number: int) -> None:
    samples = points(count, seed=seed)
    apart = torch.cdist(samples, samples)

    centres, radii = k_centres(apart, farthest_first(apart, number)[None])

    least = reference.least_radius(apart.numpy(), number)
    assert least - 1e-9 <= float(radii) <= 2 * least + 1e-9
    assert float(radii) == pytest.approx(float(apart[centres[0]].amin(0).max()))


def test_a_better_start_is_never_made_worse() -> None:
    apart = torch.cdist(points(60), points(60))
    starts = torch.stack(
        [torch.randperm(60, generator=torch.Generator().manual_seed(n))[:5] for n in range(20)]
    )

    _, radii = k_centres(apart, starts)

    assert (radii <= apart[starts].amin(1).amax(1) + 1e-12).all()


def test_centres_are_samples() -> None:
    samples = flat_samples()

    centres = kept(fit(CENTRES, samples, RGB), "centres")

    assert all(bool((samples == centre).all(1).any()) for centre in centres)


@pytest.mark.parametrize("classifier", [MEANS, CENTRES], ids=["kmeans", "kcentres"])
def test_as_many_centres_as_samples_are_the_nearest_neighbour(classifier) -> None:
    samples, pixels = flat_samples(count=8), colours()
    settings = classifier.settings(centres=20)

    found = fit(classifier, samples, RGB, settings).distance(pixels)

    torch.testing.assert_close(found, fit(NEAREST, samples, RGB).distance(pixels))
