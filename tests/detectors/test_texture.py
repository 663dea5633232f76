"""Texture detectors: the steps they compose, and what their settings reach."""

from functools import cache
from typing import Any

import pytest
import torch
from torch import Tensor

from roadtorch.detectors.catalogue import load_detector
from roadtorch.imaging.color import color_plane
from roadtorch.imaging.slic import square_grid
from roadtorch.road.seed_area import SeedArea, seed_rectangle
from roadtorch.road.texture import (
    Saturation,
    TextureSettings,
    fused_uniformity,
    quantise_plane,
    unsaturated_uniformity,
    value_range,
)
from tests.streets import saturated_street


@cache
def street() -> Tensor:
    return saturated_street()


def per_segment(cue: Tensor, segments: Tensor) -> Tensor:
    """Return the value (n,) of a cue in each segment; fail where it is not constant."""
    values = [cue[segments == number].unique() for number in segments.unique()]
    assert {len(each) for each in values} == {1}
    return torch.cat(values)


# --- what the maps are made of ------------------------------------------------------------

CUES = {
    "cpf": {"uniformity", "fused_plane", "segments"},
    "cpf:v2": {"uniformity", "fused_plane", "segments", "saturated"},
    "cpf:squares": {"uniformity", "fused_plane", "segments"},
    "grey-uniformity": {"uniformity", "segments"},
    "lbp": {"patterns", "segments"},
}


@pytest.mark.parametrize("midpoint", [0.1, 0.6])
@pytest.mark.parametrize("name", CUES)
def test_the_likelihood_is_one_per_segment_by_its_uniformity(name: str, midpoint: float) -> None:
    settings: dict[str, Any] = {"texture": {"midpoint": midpoint}}
    settings = {"grey-uniformity": settings["texture"], "lbp": {}}.get(name, settings)

    detection = load_detector(name, **settings).detect(street())

    assert set(detection.cues) == CUES[name]
    per_segment(detection.likelihood, detection.cues["segments"])
    if name != "lbp":
        uniformity = detection.cues["uniformity"]
        assert torch.allclose(detection.likelihood, uniformity / (uniformity + midpoint))


def test_grey_uniformity_is_that_of_the_grey_levels_of_each_segment() -> None:
    detection = load_detector("grey-uniformity", bins=32).detect(street())

    segments = detection.cues["segments"]
    levels = (color_plane(street(), "grey") * 32).long().clamp(0, 31)
    for number, value in enumerate(per_segment(detection.cues["uniformity"], segments)):
        shares = levels[segments == number].bincount(minlength=32) / (segments == number).sum()
        assert float(value) == pytest.approx(float(shares.square().sum()), abs=1e-5)


def test_the_fused_plane_varies_least_over_the_seed_area_and_a_single_plane_is_its_own() -> None:
    seed = SeedArea(height=60, width=120)

    cues = load_detector("cpf", seed_area=seed, texture={"ridge": 1e-6}).detect(street()).cues

    rows, columns = slice(72, 96), slice(40, 88)
    variance = cues["fused_plane"][rows, columns].var()
    for name in TextureSettings().planes:
        assert variance <= color_plane(street(), name)[rows, columns].var() * 1.001
    alone = load_detector("cpf", texture={"planes": ["ng"]}).detect(street()).cues["fused_plane"]
    assert torch.allclose(alone, color_plane(street(), "ng"))


# --- CPFv2 --------------------------------------------------------------------------------


def test_segments_that_are_mostly_saturated_have_no_uniformity_and_are_not_road() -> None:
    detection = load_detector("cpf:v2").detect(street())

    segments, clipped = detection.cues["segments"], detection.cues["saturated"]
    assert clipped[60:72, 20:44].all()
    clipped_share = torch.tensor(
        [float(clipped[segments == number].float().mean()) for number in segments.unique()]
    )
    values = per_segment(detection.cues["uniformity"], segments)
    assert (clipped_share > 0.5).any()
    assert torch.equal(values == 0, clipped_share > 0.5)
    assert not detection.mask[62:70, 24:40].any()


def test_saturated_pixels_do_not_enter_the_histogram_of_their_segment() -> None:
    labels = (torch.arange(32) >= 16).long().expand(32, 32)
    settings, generator = TextureSettings(), torch.Generator().manual_seed(0)
    spoilt = torch.rand(3, 32, 32, generator=generator) * 0.5 + 0.2
    spoilt[:, :8, :16] = 1.0  # a quarter of the first segment

    fused, values, clipped = unsaturated_uniformity(
        spoilt, labels, seed_rectangle((32, 32)), settings, Saturation()
    )

    assert torch.equal(clipped, (spoilt == 1.0).all(0))
    levels = quantise_plane(fused, settings.bins, *value_range(fused, ~clipped, settings.tail))
    for number in (0, 1):
        counts = levels[(labels == number) & ~clipped].bincount(minlength=settings.bins)
        expected = (counts / counts.sum()).square().sum()
        assert float(values[number]) == pytest.approx(float(expected), abs=1e-6)


def test_a_seed_area_without_enough_usable_pixels_gives_the_weights_with_all_of_them() -> None:
    labels, seed = square_grid(96, 128, 16), seed_rectangle((96, 128))
    above = (torch.arange(96) < 80)[:, None].expand(96, 128)

    few, usual = (
        fused_uniformity(street(), labels, usable, seed, TextureSettings())[0]
        for usable in (above, torch.ones_like(above))
    )

    assert torch.allclose(few, usual)
