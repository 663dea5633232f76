"""Illuminant invariance on a Planckian scene, whose shadow must vanish."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch import load_detector
from roadtorch.road.illuminant import (
    ANGLES,
    histogram_likelihood,
    invariant_angle,
    invariant_plane,
    log_chromaticity,
    projection_entropies,
)
from tests.reference import illuminant as reference

WAVELENGTHS = np.array([610e-9, 540e-9, 450e-9])  # metres: narrow-band sensors for R, G, B
RADIATION = 1.4388e-2  # the second radiation constant hc/k in metre kelvins
SUN, SKYLIGHT = 5500.0, 9000.0  # kelvins: a shadow outdoors is lit by the sky alone


def planckian(reflectance: np.ndarray, kelvins: float, intensity: float) -> np.ndarray:
    """Return the response (3,) to a surface under a Planckian light, in Wien's approximation."""
    light, white = (np.exp(-RADIATION / (t * WAVELENGTHS)) for t in (kelvins, SUN))
    return intensity * reflectance * light / white * (white / light)[1]


def closed_form_angle() -> float:
    """Return the invariant direction in degrees: across the one of a changing temperature."""
    red, green, blue = -RADIATION / WAVELENGTHS
    return math.degrees(math.atan2(blue - green, red - green)) % 180 - 90


@pytest.fixture
def street() -> tuple[Tensor, Tensor]:
    """Return an image (3, 60, 80) of a road between verges, half in shadow, and the road."""
    generator = np.random.default_rng(5)
    road = np.zeros((60, 80), bool)
    road[20:, 20:60] = True
    is_shadow = np.zeros((60, 80), bool)
    is_shadow[:45, :45] = True
    image = np.empty((60, 80, 3))
    for lit, (kelvins, intensity) in ((False, (SKYLIGHT, 0.3)), (True, (SUN, 1.0))):
        for is_road, colour in ((True, [0.4, 0.42, 0.45]), (False, [0.2, 0.5, 0.12])):
            pixels = (is_shadow != lit) & (road == is_road)
            image[pixels] = planckian(np.array(colour), kelvins, intensity)
    image *= generator.normal(1, 0.003, image.shape)
    return torch.from_numpy(image.clip(0, 1)).permute(2, 0, 1).float(), torch.from_numpy(road)


def test_the_plane_is_that_of_the_authors_program() -> None:
    image = torch.rand(3, 12, 16, generator=torch.Generator().manual_seed(2)).clamp_min(1 / 255)
    red, green, blue = image.double()

    plane = invariant_plane(log_chromaticity(image), 40.0)

    # GetInvariantImage.m (2012) has 5000 (x^(1/5000) - 1) for the logarithm of a ratio.
    logs = [5000 * ((part / green) ** (1 / 5000) - 1) for part in (red, blue)]
    program = math.cos(math.radians(40)) * logs[0] + math.sin(math.radians(40)) * logs[1]
    assert float((plane - program).abs().max()) < 0.005


def test_the_entropy_is_least_across_the_direction_of_light() -> None:
    generator = np.random.default_rng(1)
    colours = generator.uniform(0.1, 0.6, (12, 3))
    pixels = [
        planckian(colours[number % 12], generator.uniform(4500, 9000), generator.uniform(0.4, 1))
        for number in range(3000)
    ]
    image = np.array(pixels).T[:, None] * generator.normal(1, 0.003, (3, 1, 3000))

    angle = invariant_angle(projection_entropies(log_chromaticity(torch.from_numpy(image))))

    assert abs((angle - closed_form_angle() + 90) % 180 - 90) <= 2


def test_entropies_equal_the_reference(street: tuple[Tensor, Tensor]) -> None:
    chromaticity = log_chromaticity(street[0].double())

    entropies = projection_entropies(chromaticity)

    for angle in range(0, ANGLES, 20):
        expected = reference.entropy(chromaticity.flatten(1).numpy(), angle)
        assert float(entropies[angle]) == pytest.approx(expected, abs=1e-9)


def test_a_shadow_on_the_road_vanishes(street: tuple[Tensor, Tensor]) -> None:
    image, road = street

    masks = [
        load_detector("illuminant-invariant", threshold=0.1, invariant_angle=angle)(image).mask
        for angle in (closed_form_angle() % 180, None)
    ]

    for mask in masks:
        assert (mask == road).double().mean() > 0.97


def test_the_likelihood_is_the_frequency_of_a_value_in_the_seed() -> None:
    plane = torch.tensor([[0.0, 0.0, 1.0, 0.5]])
    seed = torch.tensor([[True, True, True, False]])

    likelihood = histogram_likelihood(plane, seed)

    assert likelihood.tolist() == [[1.0, 1.0, 0.5, 0.0]]
