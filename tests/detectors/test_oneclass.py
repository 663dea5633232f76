"""One-class detectors of P3: names, composition, shared steps."""

import re
from functools import cache
from typing import Any
from unittest.mock import patch

import pytest
import torch
from torch import Tensor

from roadtorch.base.errors import ConfigError
from roadtorch.base.image_cache import image_cache
from roadtorch.detectors.catalogue import list_detectors, load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.detector import Detector
from roadtorch.detectors.oneclass import ENTRIES
from roadtorch.imaging.color import REPRESENTATIONS, color_planes
from roadtorch.oneclass import CLASSIFIERS, FittedClassifier, fit, make_axes, samples
from roadtorch.oneclass.samples import AllSampleSettings, SampleSettings, road_samples
from roadtorch.testing.scenes import render_scene
from tests.representatives import representatives
from tests.streets import as_bytes

BY_NAME = {entry.name: entry for entry in ENTRIES}
ONE_OF_EACH = [name for name in representatives() if name in BY_NAME]


def detector(name: str, **settings: object) -> Detector:
    entry = BY_NAME[f"oneclass:{name}" if ":" in name and "oneclass" not in name else name]
    return Detector(entry, entry.make_settings(settings)).eval()


SCENE = render_scene(3, 120, 160)


@cache
def street() -> Tensor:
    return as_bytes(SCENE.image)


@cache
def detected(name: str) -> Detection:
    return detector(name).detect(street())


# --- names ------------------------------------------------------------------------------


def test_every_classifier_is_on_every_representation_but_pca_on_single_planes() -> None:
    expected = {
        f"oneclass:{classifier}:{planes}"
        for classifier in CLASSIFIERS
        for planes, names in REPRESENTATIONS.items()
        if classifier != "pca" or len(names) > 1
    }
    ours = ("robust_gaussian", "mog2", "mog4", "mog_opt", "dlp", "pca")
    paper = {f"{name}:paper" for name in expected if name.split(":")[1] in ours}

    assert len(expected) == 17 * 19 - 13
    assert {entry.name for entry in ENTRIES} == expected | paper
    assert list_detectors("oneclass:*") == sorted(expected)
    assert list_detectors("oneclass:*:paper") == sorted(paper)


@pytest.mark.parametrize(
    ("name", "settings", "problem"),
    [
        ("gaussian:RGB:paper", {}, ":gaussian:RGB:paper: is already as in the paper"),
        ("pca:R", {}, ":pca:R: one plane has a single principal component, .* .choose another"),
        ("kmeans:RGB", {"classifier": {"centre": 1}}, r"^classifier\.centre"),
    ],
)
def test_what_there_is_not_is_refused(name: str, settings: dict[str, Any], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        load_detector(f"oneclass:{name}", **settings)


def test_all_of_them_are_registered_and_look_at_an_image() -> None:
    image = render_scene(3, 24, 24).image

    with image_cache():
        for name in BY_NAME:
            detection = load_detector(name).detect(image)
            assert detection.likelihood.shape == detection.mask.shape == (24, 24), name
            low, high = detection.likelihood.aminmax()
            assert 0 <= low <= high <= 1, name
            # P3 has no values of PCA for two planes: as published, it keeps both components.
            assert low < high or re.fullmatch(r"oneclass:pca:\w+:paper", name), name


# --- what they find ---------------------------------------------------------------------


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_maps_are_those_of_the_classifier_fitted_by_hand(name: str) -> None:
    kind, representation, *paper = name.split(":")[1:]
    names, classifier = REPRESENTATIONS[representation], CLASSIFIERS[kind]
    every = AllSampleSettings() if kind.startswith("hist") else SampleSettings()
    defaults = classifier.settings.model_validate(classifier.paper if paper else {})

    detection = detected(name)

    fitted = fit(classifier, road_samples(street(), names, every), make_axes(names), defaults)
    likelihood = fitted.likelihood(color_planes(street(), names).flatten(1).T).view(120, 160)
    # Planes of the distinct colours may differ from planes of the pixels in the last digit.
    close = torch.isclose(detection.likelihood, likelihood, atol=2e-3)
    assert close.float().mean() > 0.995
    assert torch.equal(detection.mask, detection.likelihood >= 0.5)
    assert set(detection.cues) == {"distance", "seed_area"}
    assert detection.cues["distance"].isfinite().all()
    assert detection.cues["seed_area"].sum() == 16 * 50  # 66 of 480 rows, 201 of 640 columns
    assert detection.cues["seed_area"][-1, 80]


# --- the image cache ----------------------------------------------------------------------------


def test_planes_and_superpixels_are_made_once_for_all_detectors() -> None:
    names = [name for name in ONE_OF_EACH if "hist" not in name]
    with (
        patch.object(samples, "slic", wraps=samples.slic) as cut,
        patch.object(samples, "color_plane", wraps=samples.color_plane) as made,
        image_cache(),
    ):
        detections = {name: detector(name).detect(street()) for name in names}

    assert cut.call_count == 1
    planes = [call.args[1] for call in made.call_args_list]
    assert max(planes.count(name) for name in planes) <= 2  # by colours, and by distinct values
    for name in names:
        assert torch.equal(detections[name].likelihood, detected(name).likelihood)


@pytest.mark.parametrize("planes", ["R", "V"])
def test_of_a_byte_plane_no_more_than_its_levels_are_scored(planes: str) -> None:
    image = torch.randint(256, (3, 100, 100)).to(torch.float32) / 255
    sizes = []
    score = FittedClassifier.distance

    def watched(fitted: FittedClassifier, pixels: Tensor) -> Tensor:
        sizes.append(len(pixels))
        return score(fitted, pixels)

    with patch.object(FittedClassifier, "distance", watched):
        detector(f"gaussian:{planes}").detect(image)

    assert 0 < sum(sizes) <= 256
