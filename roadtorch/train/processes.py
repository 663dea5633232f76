"""The processes that train together: one, or those that torchrun started on this machine."""

import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import TypeVar

import torch
from torch import Tensor, distributed

from roadtorch.errors import RoadtorchError
from roadtorch.runtime.progress import Progress
from roadtorch.runtime.signals import Stop

Item = TypeVar("Item")


@dataclass(frozen=True)
class Processes:
    """The processes of a run, seen from one of them. The first (rank 0) writes the files.

    stop: whether somebody asked this one to stop. quiet: nobody wants to hear how far it is.
    """

    rank: int = 0
    size: int = 1
    stop: Stop = field(default_factory=Stop, compare=False)
    quiet: bool = False

    @property
    def leads(self) -> bool:
        """Whether this process writes and speaks for all."""
        return self.rank == 0

    @property
    def silent(self) -> bool:
        """Whether this process says nothing."""
        return self.quiet or not self.leads

    def share(self, items: Sequence[Item]) -> Sequence[Item]:
        """This process's part of a list that all have: every ``size``-th item."""
        return items[self.rank :: self.size]

    def each(self, items: Sequence[Item], title: str) -> Iterator[Item]:
        """This process's part of a list until it is asked to stop; the first tells how far."""
        for item in Progress(self.share(items), desc=title, unit="image", quiet=self.silent):
            if self.stop.asked:
                return
            yield item

    def add(self, values: Tensor) -> Tensor:
        """The sum of the processes' values, the same in all of them."""
        if self.size > 1:
            distributed.all_reduce(values)
        return values

    def stopped(self) -> bool:
        """Whether one of the processes was asked to stop, the same in all of them."""
        return bool(self.add(torch.tensor(float(self.stop.asked))) > 0)

    def gather(self, item: Item) -> list[Item]:
        """The items of all processes, in order of rank; waits for the slowest."""
        if self.size == 1:
            return [item]
        items: list[Item] = [item] * self.size
        distributed.all_gather_object(items, item)
        return items

    @contextmanager
    def led(self, entered: AbstractContextManager[None]) -> Iterator[None]:
        """A block that the first process enters for all; what it refuses is raised in each."""
        problem: RoadtorchError | None = None
        with ExitStack() as stack:
            if self.leads:
                try:
                    stack.enter_context(entered)
                except RoadtorchError as raised:
                    problem = raised
            refused = self.gather(problem)[0]
            if refused is not None:
                raise refused
            yield


@contextmanager
def join_processes(stop: Stop, quiet: bool = False) -> Iterator[Processes]:
    """The processes that the environment describes as torchrun does; alone where it does not."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Processes(stop=stop, quiet=quiet)
        return
    # It has the group that is there when it is imported as default arguments: imported later, as
    # optimisers do, it would keep gloo's threads alive until they crash the ending interpreter.
    import torch.distributed.nn  # noqa: F401

    distributed.init_process_group("gloo")
    try:
        yield Processes(distributed.get_rank(), distributed.get_world_size(), stop, quiet)
    finally:
        distributed.destroy_process_group()
