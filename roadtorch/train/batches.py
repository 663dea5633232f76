"""What the training loop asks of its samples."""

from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

from torch import Tensor, nn


class Batch(NamedTuple):
    """This process's part of one step.

    inputs: what the network takes, first dimension n. targets and weights: what the error
    function takes. count: samples of the step in all processes together; the error of a step
    is the sum over all of them divided by it.
    """

    inputs: Tensor
    targets: Tensor
    weights: Tensor
    count: int


class Samples(Protocol):
    """Endless samples in a settled order: epochs of chunks of batches.

    A chunk is what is in memory together, and where a run can be cut and go on.
    """

    @property
    def chunks(self) -> int:
        """Chunks of one epoch."""
        ...

    def batches(self, epoch: int, chunk: int) -> Iterator[Batch]:
        """The batches of a chunk, the same whenever they are asked for."""
        ...


ErrorFunction = Callable[[nn.Module, Batch], Tensor]
"""The summed error of a network over one process's part of a batch: a scalar."""
