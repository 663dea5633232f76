"""Principal components, k-means and k-centres: closed forms, loops and exhaustive search."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.oneclass import CLASSIFIERS
from roadtorch.oneclass.reconstruction import ComponentSettings, farthest_first, k_centres, k_means
from tests.draws import random
from tests.oneclass.cases import fitted
from tests.reference import oneclass_density as reference
from tests.reference import ufl

COMPONENTS = CLASSIFIERS["pca"]


# --- principal components ---------------------------------------------------------------


@pytest.mark.parametrize(("full", "distance"), [("cap", 0.4), ("strict", 0)])
def test_where_all_components_are_needed(full: str, distance: float) -> None:
    samples = torch.tensor([[0.6, 0.5], [0.4, 0.5], [0.5, 0.55], [0.5, 0.45]])
    settings = ComponentSettings.model_validate({"full": full})

    actual = fitted(COMPONENTS, samples, settings).distance(torch.tensor([[0.8, 0.9]]))

    assert float(actual) == pytest.approx(distance, rel=1e-5)


# --- k-means ----------------------------------------------------------------------------


@pytest.mark.parametrize("number", [1, 3, 5])
def test_the_means_are_those_of_lloyds_rounds_one_by_one(number: int) -> None:
    samples = random(60, 3)

    centres, inertia = k_means(samples, samples[None, :number])

    expected = samples[:number].numpy()
    for _ in range(25):
        expected, _ = ufl.lloyd(samples.numpy(), expected)
    np.testing.assert_allclose(centres[0], expected, atol=1e-3)
    squared = torch.cdist(samples, torch.from_numpy(expected)).square()
    assert float(inertia) == pytest.approx(float(squared.amin(1).sum()), rel=1e-4)


def test_a_centre_without_samples_moves_to_the_largest_error() -> None:
    samples = torch.tensor([[0.0], [0.1], [1.0]], dtype=torch.float64)

    centres, inertia = k_means(samples, torch.tensor([[[0.05], [9.0], [8.0]]]).double())

    assert float(inertia) < 0.006
    assert 1.0 in centres[0].flatten().tolist()


# --- k-centres --------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.integers(0, 999), st.integers(4, 12), st.integers(1, 3))
def test_the_radius_is_at_most_twice_the_least(seed: int, count: int, number: int) -> None:
    samples = random(count, 2, seed=seed)
    apart = torch.cdist(samples, samples)

    centres, radii = k_centres(apart, farthest_first(apart, number)[None])

    least = reference.least_radius(apart.numpy(), number)
    assert least - 1e-9 <= float(radii) <= 2 * least + 1e-9
    assert float(radii) == pytest.approx(float(apart[centres[0]].amin(0).max()))
