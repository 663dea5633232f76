"""The training loop: samples, steps, epochs, checkpoints; what is trained is not its business."""

import copy
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from roadtorch.errors import ConfigError
from roadtorch.layout.weights import LayoutNetwork
from roadtorch.runtime.progress import Progress
from roadtorch.runtime.signals import Stop
from roadtorch.train.config import Descent, Stopping
from roadtorch.train.folder import RunFolder
from roadtorch.train.processes import Processes

# --- randomness -------------------------------------------------------------------------


PATCH_ORDER, CENTRES, PATCH_VARIATION, PICTURE_ORDER, VARIATION = range(5)
"""What is drawn: the first number of its places, so that each has its own generators."""


def generator_at(seed: int, *place: int) -> torch.Generator:
    """A generator that belongs to this seed and place (round, epoch, chunk, …) alone.

    Nothing is carried from one place to the next, so a run that goes on in the middle draws
    what the uninterrupted one would have drawn.
    """
    state = np.random.SeedSequence([seed, *place]).generate_state(1, np.uint64)[0]
    return torch.Generator().manual_seed(int(state >> np.uint64(1)))


@contextmanager
def seeded(seed: int, *place: int) -> Iterator[None]:
    """Within the block, torch's own randomness is that of this seed and place."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(generator_at(seed, *place).initial_seed())
        yield


# --- samples ----------------------------------------------------------------------------


class Batch(NamedTuple):
    """This process's part of one step.

    inputs: what the network takes, first dimension n. targets and weights: what the loss takes.
    count: samples of the step in all processes together; the loss of a step is the sum over all
    of them divided by it.
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


Loss = Callable[[nn.Module, Batch], Tensor]
"""The summed loss of a network over one process's part of a batch: a scalar."""


# --- the mean of the weights ------------------------------------------------------------


Network = TypeVar("Network", bound=nn.Module)

WARM_UP_STEPS = 10
"""Steps over which the mean begins: the first steps' weights are soon forgotten."""


class MovingAverage(Generic[Network]):
    """The exponential moving average of a network's weights over its steps.

    Polyak and Juditsky, 1992. Each step keeps the share ``ema`` of it, in the beginning less.
    """

    def __init__(self, network: Network, ema: float) -> None:
        self.network = copy.deepcopy(network)
        self._ema = ema

    @torch.no_grad()
    def add(self, network: nn.Module, steps: int) -> None:
        """Take in the weights that a network has after ``steps`` steps."""
        kept = min(self._ema, steps / (steps + WARM_UP_STEPS)) if self._ema else 0.0
        for mean, weight in zip(self.network.parameters(), network.parameters(), strict=True):
            mean.lerp_(weight, 1 - kept)


# --- steps and epochs -------------------------------------------------------------------


SAVE_EVERY = 60.0  # seconds of work that a power cut may cost


@dataclass
class TrainingProgress:
    """How far a run is; with the weights and the optimiser's state all there is to know.

    loss, count: sums over the part of the epoch that is done. rows: the finished epochs.
    """

    round: int = 0
    epoch: int = 0
    chunk: int = 0
    steps: int = 0
    loss: float = 0.0
    count: int = 0
    seconds: float = 0.0
    finished: bool = False
    rows: list[dict[str, Any]] = field(default_factory=list)


class TrainingSetup(NamedTuple):
    """What a round trains, and how; average: what becomes of the weights over the steps."""

    network: nn.Module
    average: MovingAverage
    optimiser: torch.optim.Optimizer
    samples: Samples
    loss: Loss
    descent: Descent
    stopping: Stopping


class RoundStart(NamedTuple):
    """What a round begins with.

    files: prepared pictures. corrected: by prepared picture, what people said of it. last: the
    network of the round before, or the one that the run starts from.
    """

    number: int
    files: Sequence[Path]
    corrected: Mapping[Path, Path]
    last: LayoutNetwork | None


class RunContext(NamedTuple):
    """Where a run happens: its processes, its folder, who may interrupt or watch it."""

    processes: Processes
    folder: RunFolder
    stop: Stop
    quiet: bool = False


def make_optimiser(network: nn.Module, descent: Descent) -> torch.optim.Optimizer:
    """The optimiser that the settings name."""
    weights, rate, decay = network.parameters(), descent.learning_rate, descent.weight_decay
    if descent.method == "adam":
        return torch.optim.AdamW(weights, rate, weight_decay=decay)
    return torch.optim.SGD(weights, rate, momentum=descent.momentum, weight_decay=decay)


def train_round(setup: TrainingSetup, progress: TrainingProgress, context: RunContext) -> None:
    """Train from where ``progress`` is until the round's end, or until asked to stop.

    Saves a checkpoint at the end of each epoch, now and then between, and before it returns.
    Raises ConfigError when the loss is no longer a number.
    """
    setup.network.train()
    while not progress.finished and not context.processes.any(context.stop.asked):
        _train_epoch(setup, progress, context)
        if progress.chunk == setup.samples.chunks:
            _end_epoch(setup, progress, context)
        save_checkpoint(setup, progress, context)


def save_checkpoint(setup: TrainingSetup, progress: TrainingProgress, context: RunContext) -> None:
    """Write the checkpoint, once for all processes."""
    if context.processes.leads:
        context.folder.write_checkpoint(
            {
                "network": setup.network.state_dict(),
                "average": setup.average.network.state_dict(),
                "optimiser": setup.optimiser.state_dict(),
                "progress": asdict(progress),
            }
        )


def _train_epoch(setup: TrainingSetup, progress: TrainingProgress, context: RunContext) -> None:
    """Work through the rest of an epoch, at least a chunk of it, or until asked to stop."""
    bar = Progress(
        desc=f"epoch {progress.epoch + 1}",
        total=setup.samples.chunks,
        initial=progress.chunk,
        unit="chunk",
        quiet=context.quiet or not context.processes.leads,
    )
    saved = time.monotonic()
    with bar:
        while progress.chunk < setup.samples.chunks:
            start = time.perf_counter()
            _train_chunk(setup, progress, context.processes)
            progress.seconds += time.perf_counter() - start
            bar.set_postfix(loss=f"{progress.loss / max(1, progress.count):.4f}", refresh=False)
            bar.update()
            if time.monotonic() - saved > SAVE_EVERY:
                save_checkpoint(setup, progress, context)
                saved = time.monotonic()
            if context.processes.any(context.stop.asked):
                return


def _train_chunk(setup: TrainingSetup, progress: TrainingProgress, processes: Processes) -> None:
    epochs = progress.epoch + progress.chunk / setup.samples.chunks
    for group in setup.optimiser.param_groups:
        group["lr"] = setup.descent.learning_rate_at(epochs / setup.stopping.epochs)
    loss = 0.0
    for batch in setup.samples.batches(progress.epoch, progress.chunk):
        loss += step(setup, batch, processes)
        progress.count += batch.count
        progress.steps += 1
        setup.average.add(setup.network, progress.steps)
    if not math.isfinite(loss):
        what = "the loss is no longer a number"
        raise ConfigError("descent.learning_rate", what, "give a lower one")
    progress.loss += loss
    progress.chunk += 1


def step(setup: TrainingSetup, batch: Batch, processes: Processes) -> float:
    """One step on one batch; returns the loss summed over the batch of all processes.

    Gradients are summed over the processes, so that any number of them makes the same step up
    to rounding.
    """
    setup.optimiser.zero_grad(set_to_none=False)
    loss = torch.zeros(())
    if len(batch.inputs):
        with torch.autocast("cpu", torch.bfloat16, setup.descent.precision == "bfloat16"):
            loss = setup.loss(setup.network, batch)
        (loss / batch.count).backward()
    loss = _add_gradients(setup.network, loss.detach(), processes)
    setup.optimiser.step()
    return float(loss)


def _add_gradients(network: nn.Module, loss: Tensor, processes: Processes) -> Tensor:
    """Replace the gradients and the loss by their sums over the processes, in one exchange."""
    weights = list(network.parameters())
    for weight in weights:
        if weight.grad is None:  # this process had no sample yet
            weight.grad = torch.zeros_like(weight)
    if processes.size == 1:
        return loss
    gradients = [weight.grad for weight in weights if weight.grad is not None]
    flat = processes.add(torch.cat([loss.reshape(1), *(value.reshape(-1) for value in gradients)]))
    at = 1
    for value in gradients:
        value.copy_(flat[at : at + value.numel()].reshape(value.shape))
        at += value.numel()
    return flat[0]


def _end_epoch(setup: TrainingSetup, progress: TrainingProgress, context: RunContext) -> None:
    """Close the books of an epoch and decide whether it was the last."""
    row = {
        "round": progress.round + 1,
        "epoch": progress.epoch + 1,
        "loss": progress.loss / max(1, progress.count),
        "samples": progress.count,
        "learning_rate": setup.optimiser.param_groups[0]["lr"],
        "seconds": round(progress.seconds, 1),
    }
    before = [one["loss"] for one in progress.rows if one["round"] == row["round"]]
    fall = before[-1] - row["loss"] if before else math.inf
    progress.rows.append(row)
    progress.epoch += 1
    progress.chunk, progress.loss, progress.count, progress.seconds = 0, 0.0, 0, 0.0
    plateau = setup.stopping.rule == "plateau" and fall <= setup.stopping.min_delta
    progress.finished = plateau or progress.epoch >= setup.stopping.epochs
    if context.processes.leads:
        context.folder.write_log(progress.rows)
        if not context.quiet:
            change = f" ({-fall:+.4f})" if before else ""
            text = (
                f"roadtorch: round {row['round']} epoch {row['epoch']}: "
                f"loss {row['loss']:.4f}{change}, {row['samples']} samples in "
                f"{row['seconds']:.0f} s"
            )
            Progress.write(text, file=sys.stderr)
