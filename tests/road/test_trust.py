"""Trust: the signs of a good mask, and what is made of them."""

import pytest
import torch
from torch import Tensor

from roadtorch.road.trust import (
    CONSTANT,
    NO_ROAD,
    REASONS,
    USUAL,
    WEIGHTS,
    Signs,
    TrustSettings,
    judgement,
    signs_of,
)

NOWHERE = torch.zeros(20, 20, dtype=torch.bool)
SEED, EGO = NOWHERE.clone(), NOWHERE.clone()
SEED[18:, 4:6], EGO[15:] = True, True
ROAD = torch.zeros(20, 20)
ROAD[:, :10] = 1  # over the left half
UNSURE_ABOVE, UNSURE_BELOW = ROAD.clone(), ROAD.clone()
UNSURE_ABOVE[:5], UNSURE_BELOW[15:] = 0.5, 0.5
BEST = Signs(steady=1, expected=1, seed=1, vague=0)


def signs(
    likelihood: Tensor = ROAD,
    mask: Tensor = ROAD > 0.5,
    learned: Tensor = ROAD,
    ego: Tensor = NOWHERE,
) -> Signs:
    return signs_of(likelihood, mask, {"learned_road": learned, "seed_area": SEED, "ego": ego})


def test_the_signs_of_a_mask_tell_what_is_wrong_with_it() -> None:
    assert signs() == pytest.approx(BEST, abs=1e-6)
    # A quarter of the picture, a hundred pixels of it at the low threshold, is undecided: of the
    # 200 pixels of the mask 175 are road, and 50 beside it.
    undecided = BEST._replace(steady=150 / 250, vague=0.25, expected=2 * 175 / (200 + 200))
    assert signs(likelihood=UNSURE_ABOVE) == pytest.approx(undecided, abs=1e-6)
    assert signs(mask=~NOWHERE).expected == pytest.approx(2 * 200 / (400 + 200))
    assert signs(learned=ROAD.flip(-1)).seed == 0
    assert signs(likelihood=UNSURE_BELOW, ego=EGO) == signs(ego=EGO)  # the ego car is not asked
    assert all(0 <= sign <= 5 for sign in signs(0.6 - 0.2 * ROAD, NOWHERE))  # an empty mask


def test_better_signs_are_trusted_more_and_usual_ones_without_a_doubt() -> None:
    best = judgement(BEST, True, TrustSettings())
    usual = judgement(USUAL, True, TrustSettings())
    worst = judgement(Signs(0, 0, 0, 0), True, TrustSettings())

    assert 0 <= worst.trust < usual.trust < best.trust <= 1  # better, and in its range
    assert usual.doubt == ""
    assert worst.doubt in REASONS
    linear = CONSTANT + sum(weight * sign for weight, sign in zip(WEIGHTS, USUAL, strict=True))
    assert usual.trust == pytest.approx(linear)
    assert judgement(BEST, False, TrustSettings()) == (0.0, "no road found")


def test_where_all_is_in_doubt_there_is_no_road() -> None:
    judged = judgement(Signs(steady=0.1, expected=0.8, seed=0.9, vague=0.8), True, TrustSettings())

    assert judged.trust < 0.3
    assert judged.doubt == NO_ROAD


@pytest.mark.parametrize("number", [n for n, weight in enumerate(WEIGHTS) if weight])
def test_the_reason_is_the_sign_that_is_worse_than_usual(number: int) -> None:
    wrong = list(USUAL)
    wrong[number] = 0.0

    judged = judgement(Signs(*wrong), True, TrustSettings(least=1.0))

    assert judged.doubt == REASONS[number]
    assert judged.trust < judgement(USUAL, True, TrustSettings()).trust
