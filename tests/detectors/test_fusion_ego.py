"""The fused detector and the ego car that its network sees; with networks that see no more."""

from pathlib import Path
from typing import Any

import cv2
import pytest
import torch
from torch import Tensor

from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.detector import Detector
from roadtorch.imaging.resize import resize_maps
from roadtorch.road.ego import Ego, ego_car, extrapolate_over_ego
from roadtorch.testing import detection_violations
from tests.detectors.test_fusion import CUES
from tests.networks import write_ego_network
from tests.streets import scene

BOTTOM = 0.25


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("networks")
    return write_ego_network(folder / "seeing.safetensors", BOTTOM)


def fusion(path: Path, **settings: Any) -> Detector:
    # Superpixels of a size at which these small streets fall apart as the tests need it.
    wide = {"pixels": 256}
    changes = {"superpixels": wide, "outlines": "smooth", **settings}
    return load_detector("fusion:scratch", weights={"file": str(path)}, **changes)


def street() -> Tensor:
    return scene(3, 96, 128, shadows=0).image


@pytest.fixture(scope="module")
def detected(weights: Path) -> Detection:
    return fusion(weights).detect(street())


def car(height: int, width: int) -> Tensor:
    """Where the seeing network's ego car is, bool (H,W)."""
    return ((torch.arange(height) + 0.5) / height > 1 - BOTTOM)[:, None].expand(height, width)


def test_the_ego_car_is_where_the_network_sees_it_below_road(detected: Detection) -> None:
    right = detected.mask & scene(3, 96, 128, shadows=0).road

    assert torch.equal(detected.cues["ego"], car(96, 128))
    assert set(detected.cues) == CUES
    assert right.sum() > 0.7 * detected.mask.sum() > 0


def test_an_ego_car_that_is_told_counts_beside_the_one_found(weights: Path) -> None:
    left_half = Ego(outline=(0.0, 0.0, 1.0, 1.0))

    detection = fusion(weights, ego=left_half.model_dump(), threshold=0.0).detect(street())

    expected = car(96, 128) | ego_car(street(), left_half)
    assert torch.equal(detection.cues["ego"], expected)
    assert torch.equal(detection.mask, ~expected)
    assert not detection.likelihood[expected].any()


def test_the_ego_car_is_the_mean_of_all_looks(tmp_path: Path) -> None:
    bottom, cut = 0.4, 0.3  # of what a look sees, so of a closer one the lowest 28 % of the image
    weights = {"file": str(write_ego_network(tmp_path / "seeing.safetensors", bottom))}
    detector = load_detector("fusion", weights=weights, crops=(cut, cut))  # two against one

    free = ~detector.detect(scene(3, 200, 200, shadows=0).image).cues["ego"]

    assert free.sum(0).unique().tolist() == pytest.approx([200 * (1 - bottom * (1 - cut))], abs=6)


@pytest.mark.parametrize("seed", [6, 9])
def test_road_that_does_not_reach_the_ego_car_is_isolated(seed: int, weights: Path) -> None:
    """These have some; the seed area is in the ground that the ego car hides."""
    image, last = scene(seed, 96, 128).image, 71  # the row above the ego car

    kept, dropped = (
        fusion(weights, isolated=problem).detect(image).mask for problem in ("keep", "drop")
    )

    assert (dropped & ~kept).sum() == 0
    regions, numbers = cv2.connectedComponents(dropped.byte().numpy(), connectivity=4)
    assert {*numbers[last].tolist()} >= {*range(1, regions)}
    assert (kept & ~dropped).any()


def test_where_hidden_ground_alone_reaches_the_seed_area_nothing_is_dropped(weights: Path) -> None:
    image = scene(1, 96, 128).image

    kept, dropped = (
        fusion(weights, isolated=problem).detect(image).mask for problem in ("keep", "drop")
    )

    assert kept.any()
    assert torch.equal(dropped, kept)


def test_above_the_ground_goes_on(weights: Path, detected: Detection) -> None:
    blind = fusion(write_ego_network(weights.with_name("blind.safetensors"), 0.0))

    without = blind.detect(extrapolate_over_ego(street(), car(96, 128)))

    above = ~car(96, 128)
    assert not without.cues["ego"].any()
    assert torch.equal(detected.likelihood[above], without.likelihood[above])


@pytest.mark.parametrize("name", ["fusion", "fusion:large", "fusion:scratch"])
@pytest.mark.parametrize("size", [(16, 16), (48, 200), (480, 640)])
def test_it_holds_at_any_size(name: str, size: tuple[int, int], weights: Path) -> None:
    seeing = load_detector(name, weights={"file": str(weights)})

    detection = seeing.detect(resize_maps(street(), size).clamp(0, 1))

    ego, crops = detection.cues["ego"], getattr(seeing.settings, "crops", ())
    least = BOTTOM * (1 - max(crops, default=0))  # the lowest quarter of what each look sees
    assert least - 0.02 <= ego.double().mean() <= BOTTOM + 0.02
    assert not ego[: int((1 - BOTTOM - 0.02) * size[0])].any()
    assert not (detection.cues["seed_area"] & ego).any()
    assert (
        list(detection_violations(detection, size, "a street")) == []
    )  # neither road nor likelihood
