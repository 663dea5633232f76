"""How the trust in a network is chosen: counts of pixels, F by centre, the choice of the others."""

import numpy as np
import pytest
import torch

from roadtorch import Detection
from roadtorch.data.dataset import Truth
from train.choose_many import CENTRES
from train.choose_pool import DETAILS, OWNS, SPREAD, Worth, counted, held_out, told, worth_of
from train.choose_pool import Choice as Trusted


def pictured() -> tuple[Detection, Truth]:
    """Two pixels with the log odds -1 and 1 of which the second is road; the network says 0."""
    odds = torch.tensor([[-1.0, 1.0]])
    found = Detection(
        likelihood=(odds / SPREAD).sigmoid(),
        mask=odds > 0,
        cues={"learned_road": torch.full((1, 2), 0.5), "ego": torch.zeros(1, 2, dtype=torch.bool)},
    )
    return found, Truth(road=odds > 0, valid=torch.ones(1, 2, dtype=torch.bool))


def test_f_is_perfect_at_the_centres_between_road_and_background() -> None:
    counts = dict(counted(*pictured()))

    assert set(counts) == {(detail, own) for detail in DETAILS for own in OWNS}
    worth = worth_of({"one": counts[0.5, 0.0]}, 0.0)
    between = (CENTRES > -0.99) & (CENTRES < 0.99)
    assert worth.f[0, between] == pytest.approx(1)
    assert (worth.f[0, CENTRES < -1.01] < 1).all()
    assert worth.maxf == pytest.approx(1)


def test_what_a_network_says_moves_the_odds_by_its_detail() -> None:
    found, truth = pictured()
    sure = torch.tensor([[0.9, 0.1]])  # against what was found
    found = Detection(found.likelihood, found.mask, {**found.cues, "learned_road": sure})
    counts = dict(counted(found, truth))

    assert worth_of({"one": counts[0.25, 0.0]}, 0.0).maxf == pytest.approx(1)
    assert worth_of({"one": counts[1.0, 0.0]}, 0.0).maxf == pytest.approx(2 / 3)


def test_a_camera_has_what_the_others_choose() -> None:
    good, bad = np.zeros((3, 2)), np.zeros((3, 2))
    good[:, 0], bad[0, 1] = 0.5, 0.9
    worths = [Worth(good, np.ones(3)), Worth(bad, np.ones(3))]

    assert held_out(worths) == pytest.approx(0.5)
    assert "F 0.5000 worst 0.500" in told(Trusted(0.8, 1, 0.5, 0.25), worths[0])
