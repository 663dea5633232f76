"""What a network for whole pictures should say, where that counts, and its error."""

import pytest
import torch

from roadtorch.layout.classes import CLASSES
from roadtorch.train.batches import Batch
from roadtorch.train.config import PictureTraining, Rounds, Teacher, build_training
from roadtorch.train.targets import PictureError, Targets, centred, target_error, targets_of


def maps_of(*pixels: tuple[float, float, float, float]) -> torch.Tensor:
    """Maps (1,4,1,n): sky, vertical, horizontal, road of n pixels."""
    return torch.tensor(pixels).T[None, :, None]


def test_the_threshold_becomes_one_half_and_the_ends_stay() -> None:
    likelihood = torch.tensor([0.0, 0.2, 0.39, 0.8, 1.0])

    moved = centred(likelihood, 0.39)

    assert moved[2] == pytest.approx(0.5)
    assert moved[0] == 0
    assert moved[4] == 1
    assert (moved.diff() > 0).all()
    odds = moved[1] / (1 - moved[1])
    assert float(odds) == pytest.approx((0.2 / 0.8) / (0.39 / 0.61), rel=1e-5)


def test_only_certain_pixels_count() -> None:
    teacher = maps_of((0.9, 0.1, 0.0, 0.9), (0.5, 0.4, 0.1, 0.52), (0.2, 0.0, 0.8, 0.1))

    targets = targets_of(
        teacher, None, Teacher(margin=0.5, road_margin=0.5, road_threshold=0.5), Rounds()
    )

    assert targets.layout_weight.flatten().tolist() == [1, 0, 1]
    assert targets.road_weight.flatten().tolist() == [1, 0, 1]
    torch.testing.assert_close(targets.layout, teacher[:, :CLASSES])


def test_in_later_rounds_only_agreement_counts() -> None:
    teacher = maps_of((0.9, 0.1, 0.0, 0.9), (0.9, 0.1, 0.0, 0.9), (0.1, 0.1, 0.8, 0.1))
    network = maps_of((0.8, 0.2, 0.0, 0.8), (0.0, 1.0, 0.0, 0.1), (0.0, 0.0, 1.0, 0.9))

    targets = targets_of(
        teacher, network, Teacher(margin=0.5, road_threshold=0.5), Rounds(combine="agreement")
    )

    assert targets.layout_weight.flatten().tolist() == [1, 0, 1]
    assert targets.road_weight.flatten().tolist() == [1, 0, 0]
    torch.testing.assert_close(targets.layout, (teacher + network)[:, :CLASSES] / 2)


def test_the_last_network_alone_can_be_the_teacher() -> None:
    teacher = maps_of((0.9, 0.1, 0.0, 0.9))
    network = maps_of((0.0, 1.0, 0.0, 0.1))

    targets = targets_of(teacher, network, Teacher(), Rounds(combine="network"))

    torch.testing.assert_close(targets.layout, network[:, :CLASSES])
    torch.testing.assert_close(targets.road, network[:, CLASSES:])
    assert targets.layout_weight.item() == 1


def test_the_error_is_small_for_right_scores_and_ignores_what_does_not_count() -> None:
    layout = torch.tensor([1.0, 0, 0]).reshape(1, 3, 1, 1).expand(2, 3, 4, 4)
    road, ones = torch.ones(2, 1, 4, 4), torch.ones(2, 1, 4, 4)
    right = torch.tensor([20.0, -20, -20, 20]).reshape(1, 4, 1, 1).expand(2, 4, 4, 4)
    targets = Targets(layout, ones, road, ones)

    assert float(target_error(right, targets, 1.0)) < 1e-6
    assert float(target_error(-right, targets, 1.0)) == pytest.approx(2 * (40 + 20), rel=0.02)
    assert float(target_error(-right, targets, 0.0)) == pytest.approx(2 * 40, rel=0.02)
    nothing = targets._replace(layout_weight=0 * ones, road_weight=0 * ones)
    assert float(target_error(-right, nothing, 1.0)) == 0


@pytest.mark.parametrize("targets", ["hard", "soft"])
def test_targets_are_the_best_class_or_the_potentials(targets: str) -> None:
    training = build_training({"kind": "pictures", "teacher": {"targets": targets}})
    assert isinstance(training, PictureTraining)
    planes = torch.tensor([0.6, 0.3, 0.1, 1.0, 0.7, 1.0]).reshape(1, 6, 1, 1)
    scores = torch.zeros(1, 4, 1, 1, requires_grad=True)

    PictureError(training)(torch.nn.Identity(), Batch(scores, planes, torch.ones(1), 1)).backward()

    assert scores.grad is not None
    wanted = [1.0, 0, 0, 1.0] if targets == "hard" else [0.6, 0.3, 0.1, 0.7]
    start = torch.tensor([1 / 3, 1 / 3, 1 / 3, 0.5])
    torch.testing.assert_close(scores.grad.flatten(), start - torch.tensor(wanted))
