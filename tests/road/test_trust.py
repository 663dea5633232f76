"""Trust: the signs of a good mask, and what is made of them."""

import pytest
import torch

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
SEED = NOWHERE.clone()
SEED[18:, 4:6] = True


def road(value: float = 1.0) -> torch.Tensor:
    """A likelihood of a road over the left half."""
    found = torch.full((20, 20), 1 - value)
    found[:, :10] = value
    return found


def seen(learned: torch.Tensor, ego: torch.Tensor = NOWHERE) -> dict[str, torch.Tensor]:
    """Cues of a picture; the distance from the seed area falls from the bottom to the top."""
    distance = torch.linspace(0, 1, 20)[:, None].expand(20, 20)
    return {"learned_road": learned, "distance": distance, "seed_area": SEED, "ego": ego}


def test_a_sharp_road_that_the_network_sees_as_well_has_the_best_signs() -> None:
    found = signs_of(road(), road() > 0.5, seen(road()))

    wanted = Signs(steady=1, patchy=0, seed=1, vague=0, near=0.5)
    assert found == pytest.approx(wanted, abs=1e-6)


def test_where_the_likelihood_decides_nothing_the_mask_is_not_steady_and_vague() -> None:
    likelihood = road()
    likelihood[:5] = 0.5  # a quarter of the picture; a hundred pixels at the low threshold

    signs = signs_of(likelihood, road() > 0.5, seen(road()))

    assert signs.steady == pytest.approx(150 / 250)
    assert signs.vague == pytest.approx(0.25)


def test_a_mask_that_is_half_road_by_the_network_is_patchy() -> None:
    signs = signs_of(road(), torch.ones(20, 20, dtype=torch.bool), seen(road()))

    assert signs.patchy == pytest.approx(1)


def test_a_mask_next_to_the_seed_area_is_near() -> None:
    lower = NOWHERE.clone()
    lower[18:, :10] = True

    assert signs_of(road(), lower, seen(road())).near == pytest.approx((18 / 19 + 1) / 2)


def test_a_seed_area_that_is_no_road_to_the_network_is_told() -> None:
    assert signs_of(road(), road() > 0.5, seen(road().flip(-1))).seed == 0


def test_the_ego_car_is_not_asked() -> None:
    wrong = road().clone()
    wrong[15:] = 0.5
    ego = NOWHERE.clone()
    ego[15:] = True

    found = signs_of(wrong, road() > 0.5, seen(road(), ego))

    assert found == signs_of(road(), road() > 0.5, seen(road(), ego))


def test_an_empty_mask_has_signs_too() -> None:
    signs = signs_of(road(0.4), NOWHERE, seen(road()))

    assert all(0 <= sign <= 5 for sign in signs)


def test_entropy_is_one_bit_at_one_half_and_nothing_at_the_ends() -> None:
    assert entropy(torch.tensor([0.0, 0.5, 1.0])).tolist() == pytest.approx([0, 1, 0])


def test_a_mask_without_road_has_no_trust_and_says_so() -> None:
    assert judgement(Signs(1, 0, 1, 0, 0.5), False, TrustSettings()) == (0.0, "no road found")


def test_better_signs_are_trusted_more_and_usual_ones_without_a_doubt() -> None:
    best = judgement(Signs(1, 0, 1, 0, 0), True, TrustSettings())
    usual = judgement(USUAL, True, TrustSettings())
    worst = judgement(Signs(0, 1, 0, 1, 1), True, TrustSettings())

    assert 0 <= worst.trust < usual.trust < best.trust <= 1  # better, and in its range
    assert usual.doubt == ""
    assert worst.doubt in REASONS


@pytest.mark.parametrize("number", range(len(USUAL)))
def test_the_reason_is_the_sign_that_is_worse_than_usual(number: int) -> None:
    wrong = list(USUAL)
    wrong[number] = 0.0 if WEIGHTS[number] > 0 else 1.0

    judged = judgement(Signs(*wrong), True, TrustSettings(least=1.0))

    assert judged.doubt == REASONS[number]
    assert judged.trust < judgement(USUAL, True, TrustSettings()).trust


def test_the_expected_f_is_linear_in_the_signs() -> None:
    wanted = CONSTANT + sum(weight * sign for weight, sign in zip(WEIGHTS, USUAL, strict=True))

    assert judgement(USUAL, True, TrustSettings()).trust == pytest.approx(wanted)
