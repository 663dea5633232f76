"""Encoding, scores and selection."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.ufl import maps
from roadtorch.ufl.maps import MapSettings
from tests.draws import random
from tests.reference import ufl as reference

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
