"""The fused detector and the labeller as a detector: cues, awkward pictures, settings."""

from functools import cache

import pytest
import torch
from torch import Tensor

from roadtorch.detectors import Detection, load_detector
from roadtorch.fusion import log_odds
from roadtorch.layout.labeller import HORIZONTAL, label_layout
from tests.families.streets import lost_highlights

CUES = {
    "layout",
    "layout_labels",
    "texture",
    "uniformity",
    "fused_plane",
    "saturated",
    "distance",
    "place",
    "segments",
}


@cache
def street() -> Tensor:
    return lost_highlights(dusk=0.6)


@cache
def detected() -> Detection:
    return load_detector("fusion").detect(street())


def test_all_cues_of_the_fused_detector_are_there() -> None:
    assert set(detected().cues) == CUES


@pytest.mark.parametrize("name", ["layout", "texture", "distance", "place", "uniformity"])
def test_likelihoods_and_shares_are_between_zero_and_one(name: str) -> None:
    cue = detected().cues[name]

    assert 0 <= cue.min() < cue.max() <= 1


def test_layout_potentials_sum_to_one() -> None:
    total = detected().cues["layout"].sum(0)

    torch.testing.assert_close(total, torch.ones_like(total))


def test_the_texture_cue_leaves_out_saturated_segments() -> None:
    cues = detected().cues

    assert cues["saturated"][62:70, 22:42].all()
    assert cues["texture"][66, 32] == 0


def test_the_seed_area_is_nearest_and_the_sky_far() -> None:
    distance = detected().cues["distance"]

    assert distance[-6:, 52:76].mean() > 0.6
    assert distance[:10].max() < distance[-6:, 52:76].min()


@pytest.mark.parametrize("cue", ["fused_plane", "distance"])
def test_the_seed_area_is_that_of_the_settings_for_texture_and_distance(cue: str) -> None:
    wide = load_detector("fusion", seed={"width": 300, "height": 60}).detect(street())

    assert not torch.equal(wide.cues[cue], detected().cues[cue])


def test_without_learning_the_map_is_the_weighted_product_of_its_own_cues() -> None:
    road = {
        "rounds": 0,
        "bias": 0.5,
        "temperature": 2.0,
        "place": {"weight": 0.3},
        "weights": {"layout": 0.9, "distance": 1.3, "texture": 0.6},
    }

    found = load_detector("fusion", road=road).detect(street())

    cues = found.cues
    odds = 0.5 + 0.3 * log_odds(cues["place"]) + 0.9 * log_odds(cues["layout"][HORIZONTAL])
    odds = odds + 1.3 * log_odds(cues["distance"]) + 0.6 * log_odds(cues["texture"])
    torch.testing.assert_close(found.likelihood, (odds / 2).sigmoid(), atol=1e-4, rtol=0.0)


def test_the_labeller_as_a_detector_answers_with_its_ground() -> None:
    found = load_detector("labeller").detect(street())

    layout = label_layout(street())
    assert set(found.cues) == {"layout", "layout_labels"}
    assert torch.equal(found.likelihood, layout.potentials[HORIZONTAL])
    assert torch.equal(found.cues["layout_labels"], layout.labels)


@pytest.mark.parametrize("name", ["fusion", "labeller"])
@pytest.mark.parametrize("size", [(16, 16), (16, 250), (120, 17)])
@pytest.mark.parametrize("kind", ["flat", "black", "white", "noise"])
def test_awkward_pictures_give_finite_maps(name: str, size: tuple[int, int], kind: str) -> None:
    image = {
        "flat": torch.tensor([0.3, 0.5, 0.4]).view(3, 1, 1).expand(3, *size),
        "black": torch.zeros(3, *size),
        "white": torch.ones(3, *size),
        "noise": torch.rand(3, *size, generator=torch.Generator().manual_seed(0)),
    }[kind]

    found = load_detector(name).detect(image)

    for cue in (found.likelihood, *found.cues.values()):
        assert cue.shape[-2:] == size
        assert not cue.is_floating_point() or cue.isfinite().all()
    assert 0 <= found.likelihood.min() <= found.likelihood.max() <= 1
