"""Pictures without a road: a page, coins, a cat, the moon. scikit-image brings them."""

import pytest
import skimage.data

from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detector import Detection

THINGS = (
    *("astronaut", "brick", "cat", "cell", "checkerboard", "clock", "coffee", "coins"),
    *("colorwheel", "grass", "gravel", "hubble_deep_field", "immunohistochemistry"),
    *("microaneurysms", "moon", "page", "retina", "text"),
)


@pytest.fixture(scope="module")
def found() -> dict[str, Detection]:
    detector = load_detector("fusion")
    return {name: detector.detect(getattr(skimage.data, name)(), "rgb") for name in THINGS}


def test_of_things_that_are_no_road_most_have_no_mask_or_no_trust(
    found: dict[str, Detection],
) -> None:
    believed = {
        name for name, each in found.items() if each.mask.any() and (each.trust or 0) >= 0.3
    }

    assert len(believed) <= 2, believed
