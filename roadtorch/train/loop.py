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
from roadtorch.signals import Stop
from roadtorch.train.config import Descent, Stopping
from roadtorch.train.folder import RunFolder
from roadtorch.train.samples import Batch, ErrorOf, Samples
from roadtorch.train.team import Team

SAVE_EVERY = 60.0  # seconds of work that a power cut may cost


@dataclass
class Progress:
    """How far a run is; with the weights and the optimiser's state all there is to know.

    error, count: sums over the part of the epoch that is done. rows: the finished epochs.
    """

    round: int = 0
    epoch: int = 0
    chunk: int = 0
    error: float = 0.0
    count: int = 0
    seconds: float = 0.0
    finished: bool = False
    rows: list[dict[str, Any]] = field(default_factory=list)

    def begin_round(self, number: int) -> None:
        """Start another round from its first epoch."""
        self.round, self.epoch, self.chunk = number, 0, 0
        self.error, self.count, self.seconds, self.finished = 0.0, 0, 0.0, False


class Task(NamedTuple):
    """What a round trains, and how."""

    network: nn.Module
    optimiser: torch.optim.Optimizer
    samples: Samples
    error_of: ErrorOf
    descent: Descent
    stopping: Stopping


class Surroundings(NamedTuple):
    """Where a run happens: the processes, the folder, who may interrupt it."""

    team: Team
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


def train_round(task: Task, progress: Progress, around: Surroundings) -> None:
    """Train from where ``progress`` is until the round's end, or until asked to stop.

    Saves a checkpoint at the end of each epoch, now and then between, and before it returns.
    Raises ConfigError when the error is no longer a number.
    """
    task.network.train()
    while not progress.finished and not _stop_asked(around):
        for _ in _chunks(task, progress, around):
            if _stop_asked(around):
                break
        if progress.chunk == task.samples.chunks:
            _end_epoch(task, progress, around)
        save(task, progress, around)


def save(task: Task, progress: Progress, around: Surroundings) -> None:
    """Write the checkpoint, once for the whole team."""
    if around.team.leads:
        around.folder.write_checkpoint(
            {
                "network": task.network.state_dict(),
                "optimiser": task.optimiser.state_dict(),
                "progress": asdict(progress),
            }
        )


def _stop_asked(around: Surroundings) -> bool:
    return around.team.any(around.stop.asked)


def _chunks(task: Task, progress: Progress, around: Surroundings) -> Iterator[None]:
    """Work through the rest of an epoch; yields after each chunk."""
    title = f"epoch {progress.epoch + 1}"
    hidden = around.team.hides_bar(around.quiet)
    total, saved = task.samples.chunks, time.monotonic()
    with tqdm(
        total=total, desc=title, initial=progress.chunk, disable=hidden, file=sys.stderr
    ) as bar:
        while progress.chunk < total:
            start = time.monotonic()
            _train_chunk(task, progress, around.team)
            progress.seconds += time.monotonic() - start
            bar.update()
            bar.set_postfix(error=f"{progress.error / max(1, progress.count):.4f}")
            if time.monotonic() - saved > SAVE_EVERY:
                save(task, progress, around)
                saved = time.monotonic()
            yield


def _train_chunk(task: Task, progress: Progress, team: Team) -> None:
    share = progress.epoch + progress.chunk / task.samples.chunks
    rate = task.descent.rate_at(share / task.stopping.epochs)
    for group in task.optimiser.param_groups:
        group["lr"] = rate
    error = 0.0
    for batch in task.samples.batches(progress.epoch, progress.chunk):
        error += step(task, batch, team)
        progress.count += batch.count
    if not math.isfinite(error):
        raise ConfigError("descent.rate", "the error is no longer a number", "give a lower rate")
    progress.error += error
    progress.chunk += 1


def step(task: Task, batch: Batch, team: Team) -> float:
    """One step on one batch; returns the summed error of the whole team's batch.

    Gradients are summed over the team, so that any number of processes makes the same step
    up to rounding.
    """
    task.optimiser.zero_grad(set_to_none=False)
    error = torch.zeros(())
    if len(batch.inputs):
        error = task.error_of(task.network, batch)
        (error / batch.count).backward()
    error = _add_gradients(task.network, error.detach(), team)
    task.optimiser.step()
    return float(error)


def _add_gradients(network: nn.Module, error: Tensor, team: Team) -> Tensor:
    """Replace the gradients and the error by their sums over the team, in one exchange."""
    weights = list(network.parameters())
    for weight in weights:
        if weight.grad is None:  # this process had no sample yet
            weight.grad = torch.zeros_like(weight)
    if team.size == 1:
        return error
    gradients = [weight.grad for weight in weights if weight.grad is not None]
    flat = team.add(torch.cat([error.reshape(1), *(value.reshape(-1) for value in gradients)]))
    at = 1
    for value in gradients:
        value.copy_(flat[at : at + value.numel()].reshape(value.shape))
        at += value.numel()
    return flat[0]


def _end_epoch(task: Task, progress: Progress, around: Surroundings) -> None:
    """Close the books of an epoch and decide whether it was the last."""
    error = progress.error / max(1, progress.count)
    own = [row["error"] for row in progress.rows if row["round"] == progress.round + 1]
    fall = own[-1] - error if own else math.inf
    row = {
        "round": progress.round + 1,
        "epoch": progress.epoch + 1,
        "error": error,
        "samples": progress.count,
        "rate": task.optimiser.param_groups[0]["lr"],
        "seconds": round(progress.seconds, 1),
    }
    progress.rows.append(row)
    progress.epoch += 1
    progress.chunk, progress.error, progress.count, progress.seconds = 0, 0.0, 0, 0.0
    fallen = task.stopping.rule == "fall" and fall <= task.stopping.fall
    progress.finished = fallen or progress.epoch >= task.stopping.epochs
    if around.team.leads:
        around.folder.write_log(progress.rows)
        if not around.quiet:
            tqdm.write(_told(row, fall), file=sys.stderr)


def _told(row: dict[str, Any], fall: float) -> str:
    change = "" if math.isinf(fall) else f" ({-fall:+.4f})"
    return (
        f"roadtorch: round {row['round']} epoch {row['epoch']}: error {row['error']:.4f}{change}, "
        f"{row['samples']} samples in {row['seconds']:.0f} s"
    )
