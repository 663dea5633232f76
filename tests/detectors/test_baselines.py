"""The detectors vanishing-point and kmeans-road; images without any road."""

import pytest
import skimage.data
import torch

from roadtorch.detectors.baselines import ENTRIES
from roadtorch.detectors.catalogue import load_detector
from roadtorch.testing.scenes import render_scene

NAMES = [entry.name for entry in ENTRIES if not entry.baseline]
SCENE = render_scene(3, 180, 240)


@pytest.mark.parametrize("name", NAMES)
def test_the_road_of_a_street_is_found(name: str) -> None:
    detection = load_detector(name).detect(SCENE.image)

    mask, likelihood = detection.mask, detection.likelihood
    assert (mask & SCENE.road).sum() > 0.85 * (mask | SCENE.road).sum()
    assert likelihood.unique().tolist() == [0.0, 1.0]
    assert torch.equal(mask, likelihood > 0)


# --- images without a road --------------------------------------------------------------


THINGS = (
    *("astronaut", "brick", "cat", "cell", "checkerboard", "clock", "coffee", "coins"),
    *("colorwheel", "grass", "gravel", "hubble_deep_field", "immunohistochemistry"),
    *("microaneurysms", "moon", "page", "retina", "text"),
)


def test_most_things_without_road_have_no_mask_or_no_trust() -> None:
    detector = load_detector("fusion")
    detections = {name: detector.detect(getattr(skimage.data, name)(), "rgb") for name in THINGS}

    believed = {
        name for name, each in detections.items() if each.mask.any() and (each.trust or 0) >= 0.3
    }

    assert len(believed) <= 2, believed
