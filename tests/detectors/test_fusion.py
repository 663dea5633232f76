"""The fused detector and the labeller as a detector: cues, awkward images, settings."""

from functools import cache, partial

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.base.errors import WeightsError
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.fusion import RoadCalibration, calibrated_likelihood
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.labeller import label_layout
from roadtorch.layout.network_cues import compute_cues
from roadtorch.layout.weights import (
    DEFAULT_WEIGHTS,
    WeightsFile,
    load_image_network,
    load_network,
    shipped_weights,
)
from roadtorch.road import bayes
from roadtorch.road.appearance import fuse_appearance
from roadtorch.road.bayes import log_odds, prior_rows
from tests.streets import saturated_street


@cache
def street() -> Tensor:
    return saturated_street(dusk=0.3)


def test_saturated_segments_have_no_texture_the_seed_area_is_nearest_and_the_sky_far() -> None:
    cues = load_detector("fusion:untrained").detect(street()).cues
    distance, seed = cues["distance"], cues["seed_area"]

    for name in ("layout", "texture", "distance", "position", "uniformity"):
        assert 0 <= cues[name].min() < cues[name].max() <= 1
    assert cues["saturated"][62:70, 22:42].all()
    assert cues["texture"][66, 32] == 0
    assert distance[seed].min() > distance[:10].max()
    assert distance[seed].mean() > 1.3 * distance[~seed].mean()


def test_without_learning_it_is_the_product_of_its_cues(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bayes, "LEARNING_ROUNDS", 0)

    detection = load_detector("fusion:untrained").detect(street())

    cues = detection.cues
    odds = 0.4 * log_odds(cues["position"]) + 0.44 * log_odds(cues["layout"][HORIZONTAL])
    odds = odds + log_odds(cues["distance"]) + 2 * log_odds(cues["texture"]) - 1.8
    np.testing.assert_allclose(detection.likelihood, (odds / 6).sigmoid(), atol=1e-4, rtol=0.0)


@pytest.mark.parametrize(
    ("mirrored", "weight"), [(False, 0.0), (False, 1.0), (True, 0.0), (True, 1.0)]
)
def test_the_likelihood_is_the_calibrated_mean_of_views_fused_with_their_appearance(
    mirrored: bool, weight: float
) -> None:
    usual = {"centre": 0.5, "temperature": 2.0}
    plain = {"calibration": usual, "outlines": "smooth", "working": {"pixels": 96 * 128}}
    image, network = street(), load_network(shipped_weights(DEFAULT_WEIGHTS))
    assert isinstance(network, BackboneNetwork)

    plain |= {"mirrored": mirrored, "appearance": {"weight": weight}}
    detection = load_detector("fusion", **plain).detect(image)

    fuse = partial(fuse_appearance, weight=weight)
    mean = compute_cues(network, image, fuse)["fused_road"]
    if mirrored:
        mean = (mean + compute_cues(network, image.flip(-1), fuse)["fused_road"].flip(-1)) / 2
    expected = calibrated_likelihood(log_odds(mean), RoadCalibration(**usual))
    free = ~detection.cues["ego"]
    np.testing.assert_allclose(detection.likelihood[free], expected[free], atol=2e-3, rtol=0.0)
    if not weight and not mirrored:
        assert torch.equal(mean, compute_cues(network, image)["road"])


def test_the_mirrored_image_gives_the_mirrored_likelihood() -> None:
    detector = load_detector("fusion:large", outlines="smooth", working={"pixels": 96 * 128})

    likelihood = detector.detect(street()).likelihood
    mirrored = detector.detect(street().flip(-1)).likelihood

    np.testing.assert_allclose(mirrored.flip(-1), likelihood, atol=1e-4, rtol=0.0)


def test_the_paper_takes_another_descriptor_and_a_prior_where_told() -> None:
    usual = load_detector("fusion:paper").detect(street())

    v2_descriptor = load_detector("fusion:paper", descriptor="cpf:v2").detect(street())
    placed = load_detector("fusion:paper", prior="rows").detect(street())

    v2 = load_detector("cpf:v2").detect(street())
    assert torch.equal(v2_descriptor.cues["uniformity"], v2.cues["uniformity"])
    assert not torch.equal(v2_descriptor.cues["uniformity"], usual.cues["uniformity"])
    rows = prior_rows(*street().shape[1:])
    expected = usual.likelihood * rows / rows.max()
    np.testing.assert_allclose(placed.likelihood, expected, atol=1e-6, rtol=0.0)


def test_bayes_is_equation_4_with_the_road_of_the_network_of_fusion() -> None:
    detector = load_detector("fusion:bayes", outlines="smooth")

    result = detector.detect(street())

    paper = load_detector("fusion:paper", outlines="smooth").detect(street()).cues
    network = load_image_network(WeightsFile(), DEFAULT_WEIGHTS)
    road = compute_cues(network, street())["road"]
    rows, uniformity = prior_rows(*street().shape[1:]), paper["uniformity"]
    expected = rows / rows.max() * road * uniformity / (uniformity + 0.35)
    np.testing.assert_allclose(result.likelihood, expected, atol=1e-5, rtol=0.0)


def test_weights_for_patches_are_refused() -> None:
    with pytest.raises(WeightsError, match=r"holds a patch network .* or --detector layout:cnn-7"):
        load_detector("fusion", weights={"file": "cnn-7"})


def test_the_labeller_as_a_detector_answers_with_its_ground() -> None:
    detection = load_detector("labeller").detect(street())

    layout = label_layout(street())
    assert set(detection.cues) == {"layout", "layout_labels"}
    assert torch.equal(detection.likelihood, layout.potentials[HORIZONTAL])
    assert torch.equal(detection.cues["layout_labels"], layout.labels)
