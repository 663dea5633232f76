"""Propagation of corrections on an image of three flat regions."""

import numpy as np
import pytest
import torch

from roadtorch.annotate.propagation import ANCHOR, CONFIDENCE, CORRECTED, propagate, segment_graph
from roadtorch.annotate.views import (
    ImageView,
    compute_view,
    corrected_layout,
    corrected_log_odds,
    corrected_road,
)
from roadtorch.data.events import LABEL_NAMES
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detector import Detector
from roadtorch.imaging.segments import Segments, measure_segments
from roadtorch.imaging.slic import Superpixels
from tests.streets import scene


def three_strips() -> Segments:
    """Render a grey road on the left, a red pavement in the middle, and grass on the right."""
    image = torch.zeros(3, 48, 96)
    for place, colour in enumerate(((0.4, 0.4, 0.4), (0.6, 0.35, 0.3), (0.2, 0.5, 0.15))):
        image[:, :, 32 * place : 32 * place + 32] = torch.tensor(colour)[:, None, None]
    return measure_segments(image, Superpixels(pixels=64).cut(image))


def test_one_click_mends_the_pavement_and_leaves_the_rest() -> None:
    segments = three_strips()
    strip = (segments.column * 3).long()
    odds = torch.where(strip == 2, -2.0, 2.0)  # the machine takes the pavement for road
    evidence = torch.zeros(len(odds))
    evidence[(strip == 1).nonzero()[0, 0]] = -1
    after = odds + propagate(odds, evidence, segment_graph(segments))
    assert (after[strip == 1] < 0).all()
    assert (after[strip == 0] > 0).all()
    assert (after[strip == 2] < 0).all()


def test_what_was_said_is_held_and_nothing_said_changes_nothing() -> None:
    segments = three_strips()
    odds = torch.linspace(-6, 6, len(segments.size))
    graph = segment_graph(segments)
    evidence = torch.zeros(len(odds))
    assert (propagate(odds, evidence, graph) == 0).all()
    evidence[0], evidence[1], evidence[-1] = 1, -1, 1
    after = odds + propagate(odds, evidence, graph)
    assert after[0] == pytest.approx(CORRECTED)
    assert after[1] == pytest.approx(float(min(odds[1], torch.tensor(-CORRECTED))), abs=1e-5)
    assert after[-1] == pytest.approx(6)
    shift = propagate(odds * 0, torch.ones_like(odds), graph)  # nothing is left
    assert torch.allclose(shift, torch.full_like(odds, CORRECTED))


def test_the_field_is_the_minimum_of_what_it_is_said_to_minimise() -> None:
    segments = three_strips()
    generator = torch.Generator().manual_seed(0)
    odds = torch.randn(len(segments.size), generator=generator)
    evidence = torch.zeros(len(odds))
    evidence[3], evidence[40] = 1, -1
    graph = segment_graph(segments)
    shift = propagate(odds, evidence, graph).double().numpy()
    pull = ANCHOR + CONFIDENCE * odds.abs().double().numpy()

    def energy(field: np.ndarray) -> float:
        return float(field @ (graph @ field) + (pull * field**2).sum())

    for _ in range(20):
        step = torch.randn(len(odds), generator=generator).double().numpy() * 0.05
        step[[3, 40]] = 0
        assert energy(shift + step) >= energy(shift) - 1e-3


# --- an image --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def detector() -> Detector:
    return load_detector("labeller")


@pytest.fixture(scope="module")
def view(detector: Detector) -> ImageView:
    return compute_view(scene(0, 48, 64).image, detector)


def labels_of(**rows: slice) -> np.ndarray:
    labels = np.zeros((48, 64), np.uint8)
    for name, part in rows.items():
        labels[part] = LABEL_NAMES.index(name)
    return labels


@pytest.mark.parametrize(
    "rows", [{}, {"road": slice(10), "not_road": slice(20, 30), "void": slice(40, 44)}]
)
def test_the_machines_mask_is_shown_and_corrections_as_they_were_said(
    view: ImageView, detector: Detector, rows: dict[str, slice]
) -> None:
    labels = labels_of(**rows)
    odds = corrected_log_odds(view, labels)
    road = corrected_road(odds, labels, (48, 64))
    if not rows:
        assert torch.equal(odds, view.odds)
        mask = detector.detect(scene(0, 48, 64).image).mask
        assert (road == mask.numpy()).all()
    for name, part in rows.items():
        assert (road[part] == (name == "road")).all()


def test_the_layout_is_inferred_too(view: ImageView) -> None:
    assert set(np.unique(corrected_layout(view, labels_of()))) <= {0, 1, 2}
    assert (corrected_layout(view, labels_of(sky=slice(None))) == 0).all()
    image = scene(0, 48, 64).image
    without = compute_view(image, load_detector("prior:rows"))
    assert (corrected_layout(without, labels_of()) == 255).all()
