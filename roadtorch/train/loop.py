"""The training loop: steps, epochs, checkpoints; what is trained on what is not its business."""

import math
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from tqdm import tqdm

from roadtorch.errors import ConfigError
from roadtorch.runtime.signals import Stop
from roadtorch.train.average import AverageWeights
from roadtorch.train.batches import Batch, ErrorFunction, Samples
from roadtorch.train.config import Descent, Stopping
from roadtorch.train.folder import RunFolder
from roadtorch.train.processes import Processes

SAVE_EVERY = 60.0  # seconds of work that a power cut may cost


@dataclass
class TrainingProgress:
    """How far a run is; with the weights and the optimiser's state all there is to know.

    error, count: sums over the part of the epoch that is done. rows: the finished epochs.
    """

    round: int = 0
    epoch: int = 0
    chunk: int = 0
    steps: int = 0
    error: float = 0.0
    count: int = 0
    seconds: float = 0.0
    finished: bool = False
    rows: list[dict[str, Any]] = field(default_factory=list)

    def begin_round(self, number: int) -> None:
        """Start another round from its first epoch."""
        self.round, self.epoch, self.chunk, self.steps = number, 0, 0, 0
        self.error, self.count, self.seconds, self.finished = 0.0, 0, 0.0, False


class TrainingSetup(NamedTuple):
    """What a round trains, and how; average: what becomes of the weights over the steps."""

    network: nn.Module
    average: AverageWeights
    optimiser: torch.optim.Optimizer
    samples: Samples
    error_function: ErrorFunction
    descent: Descent
    stopping: Stopping


class RunContext(NamedTuple):
    """Where a run happens: its processes, its folder, who may interrupt or watch it."""

    processes: Processes
    folder: RunFolder
    stop: Stop
    quiet: bool = False


def make_optimiser(network: nn.Module, descent: Descent) -> torch.optim.Optimizer:
    """The optimiser that the settings name."""
    weights = list(network.parameters())
    if descent.method == "adam":
        return torch.optim.AdamW(weights, descent.rate, weight_decay=descent.decay)
    return torch.optim.SGD(
        weights, descent.rate, momentum=descent.momentum, weight_decay=descent.decay
    )


def train_round(setup: TrainingSetup, progress: TrainingProgress, context: RunContext) -> None:
    """Train from where ``progress`` is until the round's end, or until asked to stop.

    Saves a checkpoint at the end of each epoch, now and then between, and before it returns.
    Raises ConfigError when the error is no longer a number.
    """
    setup.network.train()
    while not progress.finished and not _stop_asked(context):
        for _ in _chunks(setup, progress, context):
            if _stop_asked(context):
                break
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


def _stop_asked(context: RunContext) -> bool:
    return context.processes.any(context.stop.asked)


def _chunks(
    setup: TrainingSetup, progress: TrainingProgress, context: RunContext
) -> Iterator[None]:
    """Work through the rest of an epoch; yields after each chunk."""
    title = f"epoch {progress.epoch + 1}"
    hidden = context.processes.hides_bar(context.quiet)
    total, saved = setup.samples.chunks, time.monotonic()
    with tqdm(
        total=total, desc=title, initial=progress.chunk, disable=hidden, file=sys.stderr
    ) as bar:
        while progress.chunk < total:
            start = time.perf_counter()
            _train_chunk(setup, progress, context.processes)
            progress.seconds += time.perf_counter() - start
            bar.update()
            bar.set_postfix(error=f"{progress.error / max(1, progress.count):.4f}")
            if time.monotonic() - saved > SAVE_EVERY:
                save_checkpoint(setup, progress, context)
                saved = time.monotonic()
            yield


def _train_chunk(setup: TrainingSetup, progress: TrainingProgress, processes: Processes) -> None:
    share = progress.epoch + progress.chunk / setup.samples.chunks
    rate = setup.descent.rate_at(share / setup.stopping.epochs)
    for group in setup.optimiser.param_groups:
        group["lr"] = rate
    error = 0.0
    for batch in setup.samples.batches(progress.epoch, progress.chunk):
        error += step(setup, batch, processes)
        progress.count += batch.count
        progress.steps += 1
        setup.average.add(setup.network, progress.steps)
    if not math.isfinite(error):
        raise ConfigError("descent.rate", "the error is no longer a number", "give a lower rate")
    progress.error += error
    progress.chunk += 1


def step(setup: TrainingSetup, batch: Batch, processes: Processes) -> float:
    """One step on one batch; returns the error summed over the batch of all processes.

    Gradients are summed over the processes, so that any number of them makes the same step up
    to rounding.
    """
    setup.optimiser.zero_grad(set_to_none=False)
    error = torch.zeros(())
    if len(batch.inputs):
        with torch.autocast("cpu", torch.bfloat16, setup.descent.precision == "bfloat16"):
            error = setup.error_function(setup.network, batch)
        (error / batch.count).backward()
    error = _add_gradients(setup.network, error.detach(), processes)
    setup.optimiser.step()
    return float(error)


def _add_gradients(network: nn.Module, error: Tensor, processes: Processes) -> Tensor:
    """Replace the gradients and the error by their sums over the processes, in one exchange."""
    weights = list(network.parameters())
    for weight in weights:
        if weight.grad is None:  # this process had no sample yet
            weight.grad = torch.zeros_like(weight)
    if processes.size == 1:
        return error
    gradients = [weight.grad for weight in weights if weight.grad is not None]
    flat = processes.add(torch.cat([error.reshape(1), *(value.reshape(-1) for value in gradients)]))
    at = 1
    for value in gradients:
        value.copy_(flat[at : at + value.numel()].reshape(value.shape))
        at += value.numel()
    return flat[0]


def _end_epoch(setup: TrainingSetup, progress: TrainingProgress, context: RunContext) -> None:
    """Close the books of an epoch and decide whether it was the last."""
    error = progress.error / max(1, progress.count)
    own = [row["error"] for row in progress.rows if row["round"] == progress.round + 1]
    fall = own[-1] - error if own else math.inf
    row = {
        "round": progress.round + 1,
        "epoch": progress.epoch + 1,
        "error": error,
        "samples": progress.count,
        "rate": setup.optimiser.param_groups[0]["lr"],
        "seconds": round(progress.seconds, 1),
    }
    progress.rows.append(row)
    progress.epoch += 1
    progress.chunk, progress.error, progress.count, progress.seconds = 0, 0.0, 0, 0.0
    fallen = setup.stopping.rule == "fall" and fall <= setup.stopping.fall
    progress.finished = fallen or progress.epoch >= setup.stopping.epochs
    if context.processes.leads:
        context.folder.write_log(progress.rows)
        if not context.quiet:
            tqdm.write(_told(row, fall), file=sys.stderr)


def _told(row: dict[str, Any], fall: float) -> str:
    change = "" if math.isinf(fall) else f" ({-fall:+.4f})"
    return (
        f"roadtorch: round {row['round']} epoch {row['epoch']}: error {row['error']:.4f}{change}, "
        f"{row['samples']} samples in {row['seconds']:.0f} s"
    )
