"""Preprocessing, the first dictionary, and the choice of maps."""

import numpy as np
import pytest
import torch

from roadtorch.ufl import feature_maps, features, preprocess
from roadtorch.ufl.feature_maps import MapSettings
from roadtorch.ufl.features import DictionarySettings
from tests.draws import random
from tests.reference import ufl as reference


def test_the_seed_determines_initial_bases_of_noise() -> None:
    points = random(50, 4)

    def start(random_seed: int) -> torch.Tensor:
        settings = DictionarySettings(random_seed=random_seed, bases=1000)
        return features.initial_dictionary(points, settings)

    assert torch.equal(start(3), start(3))
    assert not torch.equal(start(3), start(4))
    assert start(3).dtype == points.dtype
    assert float(start(3).std()) == pytest.approx(0.1, rel=0.05)


# --- maps -------------------------------------------------------------------------------


SIZE = (7, 5)


@pytest.mark.parametrize("kind", ["base", "patch"])
@pytest.mark.parametrize(("fraction", "count"), [(0.3, 12), (0.5, 21), (0.01, 1), (1.0, 41)])
def test_the_best_maps_are_selected_best_first(kind: str, fraction: float, count: int) -> None:
    points, dictionary = random(35, 4), random(41, 4, seed=1)
    settings = MapSettings.model_validate({"encoder": kind, "fraction": fraction})

    selected = feature_maps.select_maps(points, dictionary, SIZE, settings)

    responses = reference.responses(points.numpy(), dictionary.numpy(), kind)
    unit = responses / responses.max(axis=1, keepdims=True)
    weights = np.repeat(np.arange(7) - 3, 5)
    order = np.argsort(-(unit @ weights), kind="stable")
    assert selected.order.tolist() == order.tolist()
    np.testing.assert_allclose(selected.maps.flatten(1).numpy(), unit[order[:count]], atol=1e-6)


# --- preprocessing ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("height", "width", "size"),
    [
        (360, 480, (120, 160)),
        (375, 1242, (120, 397)),
        (16, 16, (120, 120)),
        (16, 4000, (120, 480)),
        (4000, 16, (120, 30)),
    ],
)
def test_working_sizes_of_the_paper_follow_from_the_aspect_ratio(
    height: int, width: int, size: tuple
) -> None:
    assert preprocess.WorkingShape().size(height, width) == size


def test_black_stays_black_where_the_program_divides_0_by_0() -> None:
    image = 0.3 + 0.3 * random(3, 32, 32)
    image[:, 5:25, 5:25] = 0

    equalised = preprocess.equalise(image, preprocess.Smoothing())

    assert equalised.isfinite().all()
    assert (equalised[:, 12:18, 12:18] == 0).all()


@pytest.mark.parametrize("size", [(10, 15), (37, 61), (20, 60)])
def test_bicubic_keeps_flat_images_and_8_bits(size: tuple[int, int]) -> None:
    flat = torch.full((3, 20, 30), 77 / 255, dtype=torch.float64)

    assert preprocess.resize_bicubic(flat, (20, 30)) is flat
    assert preprocess.resize_bicubic(flat, size).unique().tolist() == [77 / 255]
    levels = preprocess.resize_bicubic(random(3, 20, 30), size) * 255
    np.testing.assert_allclose(levels, levels.round(), atol=1e-9)


def test_bicubic_halves_with_the_stretched_cubic_kernel() -> None:
    # Keys' kernel (a = -1/2) at the distances 1/4, 3/4, 5/4, 7/4, both sides, each over 2.
    taps = np.array([-3, -9, 29, 111, 111, 29, -9, -3]) / 256
    image = (random(1, 1, 16).expand(3, 16, 16) * 255).round() / 255

    halved = preprocess.resize_bicubic(image, (8, 8))

    row = image[0, 0].numpy() * 255
    expected = np.floor(np.clip(row[3:11] @ taps, 0, 255) + 0.5)
    assert halved[0, 4, 3] * 255 == pytest.approx(expected)
