"""One step of training, in either precision; the moving average of the weights."""

from functools import partial
from pathlib import Path

import pytest
import torch
from torch import nn

from roadtorch.base.signals import Stop
from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings
from roadtorch.train.config import Descent, PictureTraining, Stopping
from roadtorch.train.folder import RunFolder
from roadtorch.train.loop import (
    WARM_UP_STEPS,
    Batch,
    Loop,
    MovingAverage,
    TrainingProgress,
)
from roadtorch.train.pictures import picture_loss
from roadtorch.train.teachers import PLANES
from tests.draws import seeded

# --- a step --------------------------------------------------------------------------------


def stepped(precision: str) -> tuple[float, PictureNetwork]:
    """The loss of one step on random pictures, and the network after it."""
    torch.manual_seed(0)
    network = PictureNetwork(PictureNetworkSettings(height=32, width=40, narrow=8, wide=8))
    descent = Descent.model_validate({"learning_rate": 0.1, "precision": precision})
    loss = partial(picture_loss, training=PictureTraining())
    no_samples = (1, lambda *_: iter(()))
    last = (TrainingProgress(), RunFolder(Path()), Stop())
    targets = torch.rand(2, sum(PLANES), 32, 40, generator=seeded(1))
    batch = Batch(torch.randn(2, 3, 32, 40, generator=seeded(2)), targets, torch.ones(2))
    return Loop(network, *no_samples, loss, descent, Stopping(), *last).step(batch), network


def test_a_step_in_bfloat16_is_that_in_float32_to_its_digits() -> None:
    (loss, network), (coarse, other) = stepped("float32"), stepped("bfloat16")

    assert coarse != loss
    assert coarse == pytest.approx(loss, rel=0.01)
    for one, two in zip(network.parameters(), other.parameters(), strict=True):
        assert two.dtype == torch.float32
        torch.testing.assert_close(two, one, atol=2e-3, rtol=0.02)


# --- the moving average --------------------------------------------------------------------


def with_weight(value: float) -> nn.Linear:
    network = nn.Linear(1, 1)
    torch.nn.init.constant_(network.weight, value)
    torch.nn.init.constant_(network.bias, -value)
    return network


def weight_of(average: MovingAverage[nn.Linear]) -> float:
    torch.testing.assert_close(average.network.bias, -average.network.weight[0])
    return average.network.weight.item()


def test_in_the_beginning_it_keeps_as_many_steps_as_there_were_of_those_and_ten_more() -> None:
    network, ten = with_weight(5.0), WARM_UP_STEPS
    average = MovingAverage(network, 0.999)

    average.add(with_weight(1.0), 1)
    before = (5.0 + ten) / (1 + ten)
    assert weight_of(average) == pytest.approx(before)
    average.add(with_weight(3.0), 2)
    assert weight_of(average) == pytest.approx((2 * before + ten * 3.0) / (2 + ten))
    assert network.weight.item() == 5.0  # the network that is trained is not touched


def test_later_it_keeps_the_share_that_is_asked_for() -> None:
    """With a share of 0.8, from step 40 on a step counts 0.2 of what follows it, by powers."""
    average = MovingAverage(with_weight(0.0), 0.8)
    steps = range(4 * WARM_UP_STEPS, 4 * WARM_UP_STEPS + 30)
    for number in steps:
        average.add(with_weight(float(number)), number)

    wanted = sum(0.2 * 0.8 ** (steps[-1] - number) * number for number in steps)
    assert weight_of(average) == pytest.approx(wanted, rel=1e-5)
