"""What a correction says about the rest: on a picture of three flat regions."""

import numpy as np
import pytest
import torch

from roadtorch.annotate.machine import (
    AnnotationSettings,
    PictureView,
    look_at_picture,
    mended_layout,
    mended_odds,
    said_of_segments,
    shown_road,
)
from roadtorch.annotate.propagation import PropagationSettings, propagated, segment_graph
from roadtorch.data.correction_labels import LABELS
from roadtorch.detectors.catalogue import load_detector
from roadtorch.superpixels.segments import Segments, measure_segments
from roadtorch.superpixels.slic import Superpixels
from tests.streets import scene

SETTINGS = PropagationSettings()


def three_strips() -> Segments:
    """Grey road left, a red pavement in the middle, green grass on the right."""
    image = torch.zeros(3, 48, 96)
    for place, colour in enumerate(((0.4, 0.4, 0.4), (0.6, 0.35, 0.3), (0.2, 0.5, 0.15))):
        image[:, :, 32 * place : 32 * place + 32] = torch.tensor(colour)[:, None, None]
    return measure_segments(image, Superpixels(pixels=64).cut(image))


def strip_of(segments: Segments) -> torch.Tensor:
    return (segments.column * 3).long()


def test_one_click_mends_the_pavement_and_leaves_the_rest() -> None:
    segments = three_strips()
    strip = strip_of(segments)
    odds = torch.where(strip == 2, -2.0, 2.0)  # the machine takes the pavement for road
    said = torch.zeros(len(odds))
    said[(strip == 1).nonzero()[0, 0]] = -1
    after = odds + propagated(odds, said, segment_graph(segments, SETTINGS), SETTINGS)
    assert (after[strip == 1] < 0).all()
    assert (after[strip == 0] > 0).all()
    assert (after[strip == 2] < 0).all()


def test_what_was_said_is_held_and_nothing_said_changes_nothing() -> None:
    segments = three_strips()
    odds = torch.linspace(-6, 6, len(segments.size))
    graph = segment_graph(segments, SETTINGS)
    said = torch.zeros(len(odds))
    assert (propagated(odds, said, graph, SETTINGS) == 0).all()
    said[0], said[1], said[-1] = 1, -1, 1
    after = odds + propagated(odds, said, graph, SETTINGS)
    assert after[0] == pytest.approx(SETTINGS.sure)
    assert after[1] == pytest.approx(float(min(odds[1], torch.tensor(-SETTINGS.sure))), abs=1e-5)
    assert after[-1] == pytest.approx(6)
    moved = propagated(odds * 0, torch.ones_like(odds), graph, SETTINGS)  # nothing is left
    assert torch.allclose(moved, torch.full_like(odds, SETTINGS.sure))


def test_the_field_is_the_minimum_of_what_it_is_said_to_minimise() -> None:
    segments = three_strips()
    generator = torch.Generator().manual_seed(0)
    odds = torch.randn(len(segments.size), generator=generator)
    said = torch.zeros(len(odds))
    said[3], said[40] = 1, -1
    graph = segment_graph(segments, SETTINGS)
    moved = propagated(odds, said, graph, SETTINGS).double().numpy()
    pull = SETTINGS.anchor + SETTINGS.trust * odds.abs().double().numpy()

    def energy(field: np.ndarray) -> float:
        return float(field @ (graph @ field) + (pull * field**2).sum())

    for _ in range(20):
        step = torch.randn(len(odds), generator=generator).double().numpy() * 0.05
        step[[3, 40]] = 0
        assert energy(moved + step) >= energy(moved) - 1e-3


# --- a picture --------------------------------------------------------------------------


def a_view() -> tuple[PictureView, AnnotationSettings]:
    settings = AnnotationSettings()
    return look_at_picture(scene(0, 48, 64).image, load_detector("labeller"), settings), settings


def test_before_any_correction_the_page_shows_the_machines_mask() -> None:
    image = scene(0, 48, 64).image
    detector = load_detector("labeller")
    view = look_at_picture(image, detector, AnnotationSettings())
    labels = np.zeros((48, 64), np.uint8)
    said = said_of_segments(labels, view, AnnotationSettings())
    assert not said.any()
    odds = mended_odds(view, said, SETTINGS)
    assert (shown_road(odds, labels, (48, 64)) == detector.detect(image).mask.numpy()).all()


def test_corrections_are_shown_as_they_were_said() -> None:
    view, settings = a_view()
    labels = np.zeros((48, 64), np.uint8)
    labels[:10], labels[20:30], labels[40:44] = (
        LABELS.index(one) for one in ("road", "not_road", "void")
    )
    odds = mended_odds(view, said_of_segments(labels, view, settings), settings.propagation)
    road = shown_road(odds, labels, (48, 64))
    assert road[:10].all()
    assert not road[20:30].any()
    assert not road[40:44].any()


def test_the_layout_is_inferred_too() -> None:
    view, settings = a_view()
    labels = np.zeros((48, 64), np.uint8)
    before = mended_layout(view, labels, settings)
    assert set(np.unique(before)) <= {0, 1, 2}
    labels[:] = LABELS.index("sky")
    assert (mended_layout(view, labels, settings) == 0).all()
    without = look_at_picture(scene(0, 48, 64).image, load_detector("prior:rows"), settings)
    assert (mended_layout(without, labels, settings) == 255).all()
