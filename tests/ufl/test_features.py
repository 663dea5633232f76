"""Patches, whitening, K-means; encoding, scores and selection of maps."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.ufl import features, maps
from roadtorch.ufl.features import DictionarySettings
from roadtorch.ufl.maps import MapSettings
from tests.draws import random
from tests.reference import ufl as reference


@pytest.mark.parametrize("side", [2, 3, 6])
def test_patches_are_taken_everywhere_by_rows(side: int) -> None:
    image = random(3, 8, 9)

    found = features.extract_patches(image, side)

    np.testing.assert_array_equal(found.numpy(), reference.patches(image.numpy(), side))


def test_contrast_is_normalised_over_all_channels_together() -> None:
    patches = random(5, 12).numpy()

    found = features.normalise_contrast(torch.from_numpy(patches), 0.01)

    spread = np.sqrt(patches.var(1, ddof=1, keepdims=True) + 0.01)
    np.testing.assert_allclose(found, (patches - patches.mean(1, keepdims=True)) / spread)


def test_whitening_without_epsilon_leaves_unit_covariance() -> None:
    points = random(500, 6) @ random(6, 6, seed=1)

    mean, matrix = features.zca_whitening(points, 1e-12)

    white = ((points - mean) @ matrix).numpy()
    np.testing.assert_allclose(np.cov(white.T), np.eye(6), atol=1e-6)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-9)


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 40))
def test_a_round_of_k_means_moves_bases_to_the_means_of_their_own(
    seed: int, bases: int, count: int
) -> None:
    points, start = random(count, 4, seed=seed), random(bases, 4, seed=seed + 1)

    bases_after, counts = features.update(points, start)

    expected, expected_counts = reference.lloyd(points.numpy(), start.numpy())
    np.testing.assert_allclose(bases_after.numpy(), expected, atol=1e-12)
    assert counts.tolist() == expected_counts


def test_the_random_seed_settles_a_start_of_small_noise_or_of_patches() -> None:
    points = random(50, 4)

    def start(kind: str, random_seed: int) -> torch.Tensor:
        told = {"start": kind, "random_seed": random_seed, "bases": 1000}
        return features.start_dictionary(points, DictionarySettings.model_validate(told))

    for kind in ("noise", "patches"):
        assert torch.equal(start(kind, 3), start(kind, 3))
        assert not torch.equal(start(kind, 3), start(kind, 4))
        assert start(kind, 3).dtype == points.dtype
    assert float(start("noise", 3).std()) == pytest.approx(0.1, rel=0.05)
    assert (torch.cdist(start("patches", 3), points).min(1).values < 1e-6).all()


# --- maps -------------------------------------------------------------------------------


SIZE = (7, 5)


@pytest.mark.parametrize("kind", ["base", "patch"])
@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), bases=st.integers(1, 40))
def test_responses_follow_equations_3_and_4(kind: str, seed: int, bases: int) -> None:
    points, dictionary = random(35, 4, seed=seed), random(bases, 4, seed=seed + 1)
    settings = MapSettings.model_validate({"encoder": kind})

    found = maps.make_encoder(points, dictionary, settings.encoder)(dictionary)

    expected = reference.responses(points.numpy(), dictionary.numpy(), kind)
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-6)


@pytest.mark.parametrize("kind", ["base", "patch"])
@pytest.mark.parametrize(("share", "count"), [(0.3, 12), (0.5, 21), (0.01, 1), (1.0, 41)])
def test_the_best_maps_are_kept_best_first(kind: str, share: float, count: int) -> None:
    points, dictionary = random(35, 4), random(41, 4, seed=1)
    settings = MapSettings.model_validate({"encoder": kind, "share": share})

    found = maps.select_maps(points, dictionary, SIZE, settings)

    responses = reference.responses(points.numpy(), dictionary.numpy(), kind)
    unit = responses / responses.max(axis=1, keepdims=True)
    weights = np.repeat(np.arange(7) - 3, 5)
    order = np.argsort(-(unit @ weights), kind="stable")
    assert found.order.tolist() == order.tolist()
    np.testing.assert_allclose(found.maps.flatten(1).numpy(), unit[order[:count]], atol=1e-6)
