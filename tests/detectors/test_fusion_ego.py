"""The fused detector and the ego car that its network sees; with networks that see no more."""

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.detector import Detector
from roadtorch.detectors.fusion import FusionSettings
from roadtorch.detectors.mask import decide_mask
from roadtorch.imaging.resize import resize_maps
from roadtorch.road.ego import Ego, ego_car, extrapolate_over_ego
from roadtorch.testing import detection_violations
from tests.networks import write_ego_network
from tests.streets import scene

BOTTOM = 0.25


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("networks")
    return write_ego_network(folder / "seeing.safetensors", BOTTOM)


def fusion(path: Path, **settings: Any) -> Detector:
    return load_detector("fusion", weights={"file": str(path)}, **settings)


def street() -> Tensor:
    return scene(3, 96, 128, shadows=0).image


@pytest.fixture(scope="module")
def detected(weights: Path) -> Detection:
    return fusion(weights).detect(street())


def car(height: int, width: int) -> Tensor:
    """Where the seeing network's ego car is, bool (H,W)."""
    return ((torch.arange(height) + 0.5) / height > 1 - BOTTOM)[:, None].expand(height, width)


def test_the_ego_car_is_where_the_network_sees_it_below_road(detected: Detection) -> None:
    assert torch.equal(detected.cues["ego"], car(96, 128))
    assert not (detected.mask & car(96, 128)).any()
    assert detected.mask.any()
    above = extrapolate_over_ego(detected.cues["layout"], car(96, 128))
    torch.testing.assert_close(detected.cues["layout"], above)


def test_an_ego_car_that_is_told_counts_beside_the_one_found(weights: Path) -> None:
    left_half = Ego(outline=(0.0, 0.0, 1.0, 1.0))

    detection = fusion(weights, ego=left_half.model_dump(), threshold=0.0).detect(street())

    expected = car(96, 128) | ego_car(street(), left_half)
    assert torch.equal(detection.cues["ego"], expected)
    assert torch.equal(detection.mask, ~expected)
    assert not detection.likelihood[expected].any()


@pytest.mark.parametrize(("last", "kept"), [(20, "near"), (19, "near and far")])
def test_road_stays_that_reaches_the_seed_area_or_all_of_it(last: int, kept: str) -> None:
    """The ego car hides the seed area; where hidden ground alone reaches it, nothing is dropped."""
    ego, near, far = torch.zeros(3, 25, 40, dtype=torch.bool)
    ego[20:], near[17:last, 15:25], far[5:8, 2:6] = True, True, True

    mask = decide_mask((near | far).float(), FusionSettings(), ego=ego)

    assert torch.equal(mask, near if kept == "near" else near | far)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("size", [(16, 16), (48, 200), (480, 640)])
def test_it_holds_at_any_size(mirrored: bool, size: tuple[int, int], weights: Path) -> None:
    detection = fusion(weights, mirrored=mirrored).detect(resize_maps(street(), size).clamp(0, 1))

    ego = detection.cues["ego"]
    assert BOTTOM - 0.02 <= ego.double().mean() <= BOTTOM + 0.02
    assert not ego[: int((1 - BOTTOM - 0.02) * size[0])].any()
    assert not (detection.cues["seed_area"] & ego).any()
    assert (
        list(detection_violations(detection, size, "a street")) == []
    )  # neither road nor likelihood
