"""The detectors ``vanishing-point`` and ``kmeans-road``: roads found, and pictures without any."""

import pytest
import torch
from torch import Tensor

from roadtorch.detectors.baselines import ENTRIES
from roadtorch.detectors.catalogue import load_detector
from roadtorch.scenes.street import render_scene

NAMES = [entry.name for entry in ENTRIES]


def overlap(mask: Tensor, road: Tensor) -> float:
    return float((mask & road).sum() / (mask | road).sum())


@pytest.mark.parametrize(
    ("name", "seed", "least"), [("vanishing-point", 3, 0.85), ("kmeans-road", 3, 0.85)]
)
def test_the_road_of_a_rendered_street_is_found(name: str, seed: int, least: float) -> None:
    scene = render_scene(seed, 180, 240)

    assert overlap(load_detector(name).detect(scene.image).mask, scene.road) > least


@pytest.mark.parametrize("name", NAMES)
def test_the_likelihood_is_the_mask(name: str) -> None:
    found = load_detector(name).detect(render_scene(3, 120, 160).image)

    assert found.likelihood.unique().tolist() == [0.0, 1.0]
    assert torch.equal(found.mask, found.likelihood > 0)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("level", [0.0, 0.4, 1.0])
def test_a_picture_of_one_colour_has_no_road(name: str, level: float) -> None:
    assert not load_detector(name).detect(torch.full((3, 60, 80), level)).mask.any()


def test_the_road_of_the_vanishing_point_is_a_wedge() -> None:
    mask = load_detector("vanishing-point").detect(render_scene(3, 120, 160).image).mask
    widths = mask.sum(1)
    rows = widths.nonzero()[:, 0]

    assert (widths[rows[1:]] >= widths[rows[:-1]]).all()
    assert int(rows[-1]) == 119


def test_the_bag_of_words_knows_the_seed_area() -> None:
    image = render_scene(3, 120, 160).image
    plain = load_detector("kmeans-road").detect(image).mask
    left = load_detector("kmeans-road", seed_area={"width": 320, "height": 240}).detect(image).mask

    assert not torch.equal(plain, left)
