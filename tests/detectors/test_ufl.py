"""The detectors of ``ufl``: what they compose, sizes, settings, and awkward images."""

from functools import cache
from typing import Any

import pytest
import torch
from torch import Tensor

from roadtorch.detectors.detector import Detector
from roadtorch.detectors.ufl import ENTRIES
from roadtorch.imaging.resize import resize_maps
from roadtorch.testing import detection_violations
from roadtorch.testing.scenes import render_scene
from roadtorch.ufl.road import MASK_THRESHOLD

BY_NAME = {entry.name: entry for entry in ENTRIES}
QUICK = {"working": {"rows": 48}, "dictionary": {"bases": 30, "rounds": 3}}


def detector(name: str, **settings: Any) -> Detector:
    entry = BY_NAME[name]
    return Detector(entry, entry.make_settings(settings))


@cache
def street() -> Tensor:
    return render_scene(3, 96, 128).image


def test_the_cues_show_every_stage_at_the_size_of_the_image() -> None:
    cues = detector("ufl").detect(street()).cues

    assert set(cues) == {
        *("equalised", "dictionary", "selected_maps", "best_map", "mean_map", "tree_levels"),
        *("error", "pixel_stability", "node_stability", "iteration_1", "iteration_2"),
    }
    assert all(cue.shape[-2:] == (96, 128) for cue in cues.values())
    assert cues["dictionary"].shape[0] == cues["equalised"].shape[0] == 3
    assert cues["iteration_2"].dtype == torch.bool


@pytest.mark.parametrize("size", [(96, 128), (241, 319), (120, 397)])
@pytest.mark.parametrize("name", BY_NAME)
def test_at_a_half_the_likelihood_is_the_chosen_region(name: str, size: tuple[int, int]) -> None:
    image = resize_maps(render_scene(4, 120, 160).image, size).clamp(0, 1)

    detection = detector(name, **QUICK).detect(image)

    chosen = detection.cues["iteration_2"]
    assert chosen.any()
    assert torch.equal(detection.likelihood >= MASK_THRESHOLD, chosen)


@pytest.mark.parametrize("name", BY_NAME)
@pytest.mark.parametrize("colour", [(0.0, 0.0, 0.0), (0.9, 0.2, 0.4)])
def test_without_contrast_there_is_no_road(name: str, colour: tuple[float, ...]) -> None:
    image = torch.tensor(colour)[:, None, None].expand(3, 40, 50)

    assert not detector(name, **QUICK).detect(image).mask.any()


@pytest.mark.parametrize(
    "settings",
    [
        {"dictionary": {"bases": 1}},
        {"dictionary": {"side": 16, "bases": 8}, "working": {"rows": 16}},
        {"maps": {"fraction": 1.0}, "dictionary": {"bases": 6}},
        {"tree": {"min_area": 10**6}, "dictionary": {"bases": 20}},
        {"tree": {"min_area": 1}, "dictionary": {"bases": 20}},
        {"road": {"dilation": 0, "rounds": 1}, "dictionary": {"bases": 20, "rounds": 0}},
    ],
)
@pytest.mark.parametrize("name", ["ufl", "ufl:paper"])
def test_extreme_settings_work(name: str, settings: dict[str, Any]) -> None:
    detection = detector(name, **{"working": {"rows": 48}, **settings}).detect(street())

    assert list(detection_violations(detection, (96, 128), "a street")) == []
