"""Trust: the signs of a good mask, and what is made of them."""

import pytest
import torch
from torch import Tensor

from roadtorch.road.trust import (
    CONSTANT,
    REASONS,
    USUAL,
    WEIGHTS,
    Signs,
    TrustSettings,
    entropy,
    judgement,
    signs_of,
)

NOWHERE = torch.zeros(20, 20, dtype=torch.bool)
SEED, EGO, LOWEST = NOWHERE.clone(), NOWHERE.clone(), NOWHERE.clone()
SEED[18:, 4:6], EGO[15:], LOWEST[18:, :10] = True, True, True
ROAD = torch.zeros(20, 20)
ROAD[:, :10] = 1  # over the left half
UNSURE_ABOVE, UNSURE_BELOW = ROAD.clone(), ROAD.clone()
UNSURE_ABOVE[:5], UNSURE_BELOW[15:] = 0.5, 0.5
BEST = Signs(steady=1, patchy=0, seed=1, vague=0, near=0.5)


def signs(
    likelihood: Tensor = ROAD,
    mask: Tensor = ROAD > 0.5,
    learned: Tensor = ROAD,
    ego: Tensor = NOWHERE,
) -> Signs:
    """Of a picture in which the distance from the seed area falls from the bottom to the top."""
    distance = torch.linspace(0, 1, 20)[:, None].expand(20, 20)
    cues = {"learned_road": learned, "distance": distance, "seed_area": SEED, "ego": ego}
    return signs_of(likelihood, mask, cues)


def test_the_signs_of_a_mask_tell_what_is_wrong_with_it() -> None:
    assert signs() == pytest.approx(BEST, abs=1e-6)  # sharp, and road to the network as well
    # A quarter of the picture, a hundred pixels of it at the low threshold, is undecided.
    undecided = BEST._replace(steady=150 / 250, vague=0.25)
    assert signs(likelihood=UNSURE_ABOVE) == pytest.approx(undecided, abs=1e-6)
    assert signs(mask=~NOWHERE).patchy == pytest.approx(1)  # half of it is road by the network
    assert signs(mask=LOWEST).near == pytest.approx((18 / 19 + 1) / 2)
    assert signs(learned=ROAD.flip(-1)).seed == 0
    assert signs(likelihood=UNSURE_BELOW, ego=EGO) == signs(ego=EGO)  # the ego car is not asked
    assert all(0 <= sign <= 5 for sign in signs(0.6 - 0.2 * ROAD, NOWHERE))  # an empty mask


def test_entropy_is_one_bit_at_one_half_and_nothing_at_the_ends() -> None:
    assert entropy(torch.tensor([0.0, 0.5, 1.0])).tolist() == pytest.approx([0, 1, 0])


def test_better_signs_are_trusted_more_and_usual_ones_without_a_doubt() -> None:
    best = judgement(Signs(1, 0, 1, 0, 0), True, TrustSettings())
    usual = judgement(USUAL, True, TrustSettings())
    worst = judgement(Signs(0, 1, 0, 1, 1), True, TrustSettings())

    assert 0 <= worst.trust < usual.trust < best.trust <= 1  # better, and in its range
    assert usual.doubt == ""
    assert worst.doubt in REASONS
    linear = CONSTANT + sum(weight * sign for weight, sign in zip(WEIGHTS, USUAL, strict=True))
    assert usual.trust == pytest.approx(linear)
    assert judgement(BEST, False, TrustSettings()) == (0.0, "no road found")


@pytest.mark.parametrize("number", range(len(USUAL)))
def test_the_reason_is_the_sign_that_is_worse_than_usual(number: int) -> None:
    wrong = list(USUAL)
    wrong[number] = 0.0 if WEIGHTS[number] > 0 else 1.0

    judged = judgement(Signs(*wrong), True, TrustSettings(least=1.0))

    assert judged.doubt == REASONS[number]
    assert judged.trust < judgement(USUAL, True, TrustSettings()).trust
