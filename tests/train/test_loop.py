"""One step of training, in either precision."""

import pytest
import torch

from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings
from roadtorch.train.config import Descent, PictureTraining, Stopping
from roadtorch.train.loop import AverageWeights, Batch, TrainingSetup, make_optimiser, step
from roadtorch.train.processes import Processes
from roadtorch.train.teachers import PLANES, PictureError


class OneBatch:
    """Samples are not asked for: the step is given its batch."""

    chunks = 1

    def batches(self, epoch: int, chunk: int) -> list[Batch]:
        raise AssertionError


def stepped(precision: str) -> tuple[float, PictureNetwork]:
    """The error of one step on random pictures, and the network after it."""
    torch.manual_seed(0)
    network = PictureNetwork(PictureNetworkSettings(height=32, width=40, narrow=8, wide=8))
    descent = Descent.model_validate({"rate": 0.1, "precision": precision})
    setup = TrainingSetup(
        network,
        AverageWeights(network, 0.0),
        make_optimiser(network, descent),
        OneBatch(),  # type: ignore[arg-type]
        PictureError(PictureTraining()),
        descent,
        Stopping(),
    )
    at = torch.Generator().manual_seed(1)
    targets = torch.rand(2, sum(PLANES), 32, 40, generator=at)
    batch = Batch(torch.randn(2, 3, 32, 40, generator=at), targets, torch.ones(2), 2)
    return step(setup, batch, Processes()), network


def test_a_step_in_bfloat16_is_that_in_float32_to_its_digits() -> None:
    (error, network), (coarse, other) = stepped("float32"), stepped("bfloat16")

    assert coarse != error
    assert coarse == pytest.approx(error, rel=0.01)
    for one, two in zip(network.parameters(), other.parameters(), strict=True):
        assert two.dtype == torch.float32
        torch.testing.assert_close(two, one, atol=2e-3, rtol=0.02)
