"""The detectors ``vanishing-point`` and ``kmeans-road``: roads found, and pictures without any."""

import pytest
import torch

from roadtorch.detectors.baselines import ENTRIES
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detector import Detection
from roadtorch.testing.scenes import render_scene
from tests.representatives import quick

NAMES = [entry.name for entry in ENTRIES if not entry.baseline]
SCENE = render_scene(3, 180, 240)


@pytest.fixture(scope="module")
def detections() -> dict[str, Detection]:
    return {name: load_detector(name).detect(SCENE.image) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_the_road_of_a_rendered_street_is_found(
    name: str, detections: dict[str, Detection]
) -> None:
    mask, likelihood = detections[name].mask, detections[name].likelihood

    assert (mask & SCENE.road).sum() > 0.85 * (mask | SCENE.road).sum()
    assert likelihood.unique().tolist() == [0.0, 1.0]
    assert torch.equal(mask, likelihood > 0)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("level", [0.0, 0.4, 1.0])
def test_a_picture_of_one_colour_has_no_road(name: str, level: float) -> None:
    detector = load_detector(name, **quick(name))

    assert not detector.detect(torch.full((3, 60, 80), level)).mask.any()


def test_the_road_of_the_vanishing_point_is_a_wedge(detections: dict[str, Detection]) -> None:
    widths = detections["vanishing-point"].mask.sum(1)
    rows = widths.nonzero()[:, 0]

    assert (widths[rows[1:]] >= widths[rows[:-1]]).all()
    assert int(rows[-1]) == 179
