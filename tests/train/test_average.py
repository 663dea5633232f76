"""The running mean of the weights: its closed form, and what it leaves alone."""

import pytest
import torch
from torch import nn

from roadtorch.train.loop import FIRST, AverageWeights


def with_weight(value: float) -> nn.Linear:
    network = nn.Linear(1, 1)
    with torch.no_grad():
        network.weight.fill_(value)
        network.bias.fill_(-value)
    return network


def weight_of(average: AverageWeights) -> float:
    assert isinstance(average.network, nn.Linear)
    torch.testing.assert_close(average.network.bias, -average.network.weight[0])
    return average.network.weight.item()


def test_in_the_beginning_it_keeps_as_many_steps_as_there_were_of_those_and_ten_more() -> None:
    average = AverageWeights(with_weight(5.0), 0.999)

    average.add(with_weight(1.0), 1)
    assert weight_of(average) == pytest.approx((1 * 5.0 + FIRST * 1.0) / (1 + FIRST))

    average.add(with_weight(3.0), 2)
    before = (5.0 + FIRST) / (1 + FIRST)
    assert weight_of(average) == pytest.approx((2 * before + FIRST * 3.0) / (2 + FIRST))


def test_later_it_keeps_the_share_that_is_asked_for() -> None:
    """With a share of 0.8, from step 40 on a step counts 0.2 of what follows it, by powers."""
    average = AverageWeights(with_weight(0.0), 0.8)
    steps = range(4 * FIRST, 4 * FIRST + 30)

    for step in steps:
        average.add(with_weight(float(step)), step)

    wanted = sum(0.2 * 0.8 ** (steps[-1] - step) * step for step in steps)
    assert weight_of(average) == pytest.approx(wanted, rel=1e-5)


def test_weights_that_stay_are_their_own_mean() -> None:
    average = AverageWeights(with_weight(0.7), 0.99)

    for step in range(1, 50):
        average.add(with_weight(0.7), step)

    assert weight_of(average) == pytest.approx(0.7, abs=1e-6)


def test_a_share_of_nothing_is_the_last_step() -> None:
    average = AverageWeights(with_weight(5.0), 0.0)

    average.add(with_weight(-2.0), 1000)

    assert weight_of(average) == -2.0


def test_the_network_that_is_trained_is_not_touched() -> None:
    network = with_weight(5.0)
    average = AverageWeights(network, 0.5)

    average.add(with_weight(1.0), 1)

    assert network.weight.item() == 5.0
