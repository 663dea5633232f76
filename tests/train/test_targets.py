"""What a network for whole pictures should say, where that counts, and its error."""

import pytest
import torch

from roadtorch.layout.classes import CLASSES
from roadtorch.road.fusion import log_odds
from roadtorch.road.otsu import otsu_threshold
from roadtorch.train.config import (
    HeadWeights,
    PictureTraining,
    Rounds,
    Teacher,
    build_training,
)
from roadtorch.train.loop import Batch
from roadtorch.train.teachers import (
    PictureError,
    Targets,
    best_class,
    centred_as,
    target_error,
    targets_of,
)

EVEN = Teacher(margin=0.5, road_threshold=0.5)


def maps_of(*pixels: tuple[float, ...]) -> torch.Tensor:
    """Maps (1,C,1,n) of n pixels: sky, vertical, horizontal, road; of networks the ego car too."""
    return torch.tensor(pixels).T[None, :, None]


def ego_of(*pixels: float) -> torch.Tensor:
    """The ego car (1,1,1,n) as a prepared picture has it, in bytes."""
    return (torch.tensor(pixels) * 255).round().reshape(1, 1, 1, -1) / 255


def unknown(count: int) -> torch.Tensor:
    return ego_of(*[0.5] * count)


# --- what means as likely road as not ------------------------------------------------------


def centred(likelihood: torch.Tensor, **settings: float) -> torch.Tensor:
    return centred_as(likelihood, Teacher(**settings))  # type: ignore[arg-type]


def test_the_threshold_becomes_one_half_and_the_ends_stay() -> None:
    likelihood = torch.tensor([0.0, 0.2, 0.39, 0.8, 1.0]).reshape(1, 1, 1, 5)

    moved = centred(likelihood, road_threshold=0.39).flatten()

    assert moved[2] == pytest.approx(0.5)
    assert moved[0] == pytest.approx(0, abs=1e-3)
    assert moved[4] == pytest.approx(1, abs=1e-3)
    assert (moved.diff() > 0).all()
    odds = moved[1] / (1 - moved[1])
    assert float(odds) == pytest.approx((0.2 / 0.8) / (0.39 / 0.61), rel=1e-4)


def cameras() -> torch.Tensor:
    """Likelihoods (2,1,H,W): the same road seen by two teachers' cameras, one of them timid."""
    odds = torch.randn(1, 1, 20, 30, generator=torch.Generator().manual_seed(3)).repeat(2, 1, 1, 1)
    odds[:, :, 10:] += 4
    odds[1] -= 3
    return odds.sigmoid()


def test_in_each_picture_the_cut_that_parts_it_best_becomes_one_half() -> None:
    moved = centred(cameras(), centre=1.0)

    for one, picture in zip(moved, cameras(), strict=True):
        found = log_odds(picture)
        torch.testing.assert_close(one, (found - otsu_threshold(found)).sigmoid())
    assert torch.equal(moved[0] >= 0.5, moved[1] >= 0.5)
    assert 0.4 < (moved[0] >= 0.5).float().mean() < 0.6


def test_between_the_two_the_log_odds_are_shared() -> None:
    fixed, own, half = (log_odds(centred(cameras(), centre=share)) for share in (0.0, 1.0, 0.5))

    torch.testing.assert_close(half, (fixed + own) / 2, atol=1e-3, rtol=0)


# --- where it counts -----------------------------------------------------------------------


def test_only_certain_pixels_count() -> None:
    teacher = maps_of((0.9, 0.1, 0.0, 0.9), (0.5, 0.4, 0.1, 0.52), (0.2, 0.0, 0.8, 0.1))
    settings = Teacher(margin=0.5, road_margin=0.5, road_threshold=0.5)

    targets = targets_of(teacher, unknown(3), None, settings, Rounds())

    assert targets.layout_weight.flatten().tolist() == [1, 0, 1]
    assert targets.road_weight.flatten().tolist() == [1, 0, 1]
    torch.testing.assert_close(targets.layout, teacher[:, :CLASSES])


def test_in_later_rounds_only_agreement_counts() -> None:
    teacher = maps_of((0.9, 0.1, 0.0, 0.9), (0.9, 0.1, 0.0, 0.9), (0.1, 0.1, 0.8, 0.1))
    network = maps_of(
        (0.8, 0.2, 0.0, 0.8, 0.0), (0.0, 1.0, 0.0, 0.1, 0.0), (0.0, 0.0, 1.0, 0.9, 0.0)
    )

    targets = targets_of(teacher, unknown(3), network, EVEN, Rounds(combine="agreement"))

    assert targets.layout_weight.flatten().tolist() == [1, 0, 1]
    assert targets.road_weight.flatten().tolist() == [1, 0, 0]
    torch.testing.assert_close(targets.layout, (teacher + network[:, :4])[:, :CLASSES] / 2)


def test_the_last_network_alone_can_be_the_teacher() -> None:
    teacher = maps_of((0.9, 0.1, 0.0, 0.9))
    network = maps_of((0.0, 1.0, 0.0, 0.1, 0.0))

    targets = targets_of(teacher, unknown(1), network, Teacher(), Rounds(combine="network"))

    torch.testing.assert_close(targets.layout, network[:, :CLASSES])
    torch.testing.assert_close(targets.road, network[:, CLASSES : CLASSES + 1])
    assert targets.layout_weight.item() == 1


# --- the ego car ---------------------------------------------------------------------------

GROUND = (0.0, 0.1, 0.9, 0.9)
"""What the teacher says of ground, and of the ground that it sees in place of an ego car."""


def test_the_ego_car_of_the_footage_is_known_both_ways() -> None:
    targets = targets_of(maps_of(GROUND, GROUND), ego_of(0, 1), None, EVEN, Rounds())

    assert targets.ego.flatten().tolist() == [0, 1]
    assert targets.ego_weight.flatten().tolist() == [1, 1]


def test_where_nothing_is_known_of_it_there_is_none_at_first() -> None:
    targets = targets_of(maps_of(GROUND), unknown(1), None, EVEN, Rounds())

    assert (targets.ego.item(), targets.ego_weight.item()) == (0, 1)
    assert targets.layout_weight.item() == targets.road_weight.item() == 1
    assert targets.road.item() == pytest.approx(0.9)


def test_from_the_second_round_on_the_network_says_it_where_it_is_unknown() -> None:
    network = maps_of(*[(*GROUND, ego) for ego in (0.95, 0.05, 0.7, 0.05, 0.95)])
    teacher = maps_of(*[GROUND] * 5)

    targets = targets_of(teacher, ego_of(0.5, 0.5, 0.5, 1, 0), network, EVEN, Rounds())

    assert targets.ego.flatten().tolist() == [1, 0, 0, 1, 0]  # what it half believes is none
    assert targets.ego_weight.flatten().tolist() == [1, 1, 1, 1, 1]
    torch.testing.assert_close(targets.road.flatten(), torch.tensor([0, 0.9, 0.9, 0, 0.9]))


def test_on_the_ego_car_there_is_no_road_and_no_layout_that_counts() -> None:
    targets = targets_of(maps_of(GROUND, GROUND), ego_of(0, 1), None, EVEN, Rounds())

    torch.testing.assert_close(targets.road.flatten(), torch.tensor([0.9, 0.0]))
    assert targets.road_weight.flatten().tolist() == [1, 1]
    assert targets.layout_weight.flatten().tolist() == [1, 0]


@pytest.mark.parametrize("said", [0.1, 0.9])
def test_that_it_is_no_road_counts_whatever_the_last_network_says(said: float) -> None:
    """The teacher sees the ground go on: it cannot agree with a network that knows better."""
    network = maps_of((0.0, 0.1, 0.9, said, 0.9))

    targets = targets_of(maps_of(GROUND), ego_of(1), network, EVEN, Rounds())

    assert (targets.road.item(), targets.road_weight.item()) == (0, 1)


# --- the error -----------------------------------------------------------------------------


def test_the_error_is_small_for_right_scores_and_ignores_what_does_not_count() -> None:
    layout = torch.tensor([1.0, 0, 0]).reshape(1, 3, 1, 1).expand(2, 3, 4, 4)
    ones = torch.ones(2, 1, 4, 4)
    right = torch.tensor([20.0, -20, -20, 20, -30]).reshape(1, 5, 1, 1).expand(2, 5, 4, 4)
    targets = Targets(layout, ones, ones, ones, 0 * ones, ones)

    def error(scores: torch.Tensor, road: float, ego: float, said: Targets = targets) -> float:
        return float(target_error(scores, said, HeadWeights(road=road, ego=ego)))

    assert error(right, 1, 1) < 1e-6
    assert error(-right, 1, 1) == pytest.approx(2 * (40 + 20 + 30), rel=0.02)
    assert error(-right, 1, 0) == pytest.approx(2 * (40 + 20), rel=0.02)
    assert error(-right, 0, 0.5) == pytest.approx(2 * (40 + 15), rel=0.02)
    nothing = targets._replace(layout_weight=0 * ones, road_weight=0 * ones, ego_weight=0 * ones)
    assert error(-right, 1, 1, nothing) == 0


@pytest.mark.parametrize("targets", ["hard", "soft"])
def test_targets_are_the_best_class_or_the_potentials(targets: str) -> None:
    training = build_training(
        {"kind": "pictures", "teacher": {"targets": targets}, "heads": {"ego": 2.0}}
    )
    assert isinstance(training, PictureTraining)
    planes = torch.tensor([0.6, 0.3, 0.1, 1.0, 0.7, 1.0, 0.8, 1.0]).reshape(1, 8, 1, 1)
    scores = torch.zeros(1, 5, 1, 1, requires_grad=True)

    PictureError(training)(torch.nn.Identity(), Batch(scores, planes, torch.ones(1), 1)).backward()

    assert scores.grad is not None
    wanted = [1.0, 0, 0, 1.0] if targets == "hard" else [0.6, 0.3, 0.1, 0.7]
    start = torch.tensor([1 / 3, 1 / 3, 1 / 3, 0.5])
    torch.testing.assert_close(scores.grad.flatten()[:4], start - torch.tensor(wanted))
    assert scores.grad.flatten()[4] == pytest.approx(2 * (0.5 - 0.8))  # the ego car stays soft


def test_targets_are_averaged_to_the_size_of_the_scores() -> None:
    training = build_training({"kind": "pictures", "teacher": {"targets": "soft"}})
    assert isinstance(training, PictureTraining)
    fine = torch.rand(2, 8, 6, 8, generator=torch.Generator().manual_seed(0))
    scores = torch.randn(2, 5, 3, 4, generator=torch.Generator().manual_seed(1))

    error = PictureError(training)(torch.nn.Identity(), Batch(scores, fine, torch.ones(2), 2))

    small = Targets(*fine.unfold(2, 2, 2).unfold(3, 2, 2).mean((4, 5)).split((3, 1, 1, 1, 1, 1), 1))
    torch.testing.assert_close(error, target_error(scores, small, training.heads))


def test_the_best_class_is_the_one_that_argmax_names() -> None:
    layout = torch.rand(2, CLASSES, 5, 7, generator=torch.Generator().manual_seed(0))
    assert best_class(layout).equal(layout.argmax(1, keepdim=True))
