"""The training loop: samples, steps, epochs, checkpoints; what is trained is not its business."""

import copy
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from roadtorch.base.errors import ConfigError, WeightsError
from roadtorch.base.progress import Progress
from roadtorch.base.signals import Stop
from roadtorch.layout.weights import LayoutNetwork, fill
from roadtorch.train.config import Descent, Stopping
from roadtorch.train.folder import CHECKPOINT, NO_CHECKPOINT, RunFolder

# --- randomness -------------------------------------------------------------------------


PATCH_ORDER, CENTRES, PATCH_VARIATION, IMAGE_ORDER, VARIATION = range(5)
"""What is drawn: the first number of its places, so that each has its own generators."""


def generator_at(seed: int, *place: int) -> torch.Generator:
    """A generator that belongs to this seed and place (epoch, chunk, …) alone.

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
        kept = min(self._ema, steps / (steps + WARM_UP_STEPS))
        for mean, weight in zip(self.network.parameters(), network.parameters(), strict=True):
            mean.lerp_(weight, 1 - kept)


# --- steps and epochs -------------------------------------------------------------------


SAVE_EVERY = 60.0  # seconds of work that a power cut may cost


class TrainingInputs(NamedTuple):
    """What a network learns from.

    files: prepared images. corrected: the file of the correction of a prepared image, if it
    has one. start: the network that the run starts from, if any. labels: the folder for its labels.
    """

    files: Sequence[Path]
    corrected: Mapping[Path, Path]
    start: LayoutNetwork | None
    labels: Path


class Batch(NamedTuple):
    """The samples of one step.

    inputs: what the network takes, first dimension n. targets and weights: what the loss takes.
    """

    inputs: Tensor
    targets: Tensor
    weights: Tensor


@dataclass
class TrainingProgress:
    """How far a run is; with the weights and the optimiser's state all there is to know.

    loss, count: sums over the part of the epoch that is done. rows: the finished epochs.
    """

    epoch: int = 0
    chunk: int = 0
    steps: int = 0
    loss: float = 0.0
    count: int = 0
    seconds: float = 0.0
    finished: bool = False
    rows: list[dict[str, Any]] = field(default_factory=list)


@dataclass
class Loop:
    """The epochs of a run: a network that learns, its average, and how far they are.

    batches: those of an epoch and a chunk, the same whenever they are asked for. chunks: of an
    epoch; each is in memory as a whole, and between them a run can be cut and resumed. loss: of a
    network, summed over a batch, a scalar. part: which of how many alike trainings this is: the bar
    shows what is left of all.
    """

    network: LayoutNetwork
    chunks: int
    batches: Callable[[int, int], Iterator[Batch]]
    loss: Callable[[nn.Module, Batch], Tensor]
    descent: Descent
    stopping: Stopping
    progress: TrainingProgress
    folder: RunFolder
    stop: Stop
    quiet: bool = False
    part: tuple[int, int] = (1, 1)

    def __post_init__(self) -> None:
        """The average of the weights, and the optimiser that the settings name."""
        descent = self.descent
        self.average = MovingAverage(self.network, descent.ema)
        weights, rate, decay = (
            self.network.parameters(),
            descent.learning_rate,
            descent.weight_decay,
        )
        self._optimiser: torch.optim.Optimizer = (
            torch.optim.AdamW(weights, rate, weight_decay=decay)
            if descent.method == "adam"
            else torch.optim.SGD(weights, rate, descent.momentum, weight_decay=decay)
        )

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take weights and optimiser from a checkpoint; WeightsError for one that lacks them."""
        path = self.folder.path / CHECKPOINT
        try:
            fill(self.network, state["network"], path)
            fill(self.average.network, state["average"], path)
            self._optimiser.load_state_dict(state["optimiser"])
        except (KeyError, TypeError, ValueError, AttributeError):
            raise WeightsError(path, *NO_CHECKPOINT) from None

    def train(self) -> None:
        """Train from where ``progress`` is to the last epoch, or until asked to stop.

        Saves a checkpoint at the end of each epoch, now and then between, and before it returns.
        Raises ConfigError when the loss is no longer a number.
        """
        self.network.train()
        with self._bar() as bar:
            while not self.progress.finished and not self.stop.asked:
                self._train_epoch(bar)
                if self.progress.chunk == self.chunks:
                    self._end_epoch()
            self.save()

    def save(self) -> None:
        """Write the checkpoint."""
        self.folder.write_checkpoint(
            {
                "network": self.network.state_dict(),
                "average": self.average.network.state_dict(),
                "optimiser": self._optimiser.state_dict(),
                "progress": asdict(self.progress),
            }
        )

    def _train_epoch(self, bar: Progress) -> None:
        """Work through the rest of an epoch, at least a chunk of it, or until asked to stop."""
        progress, saved = self.progress, time.monotonic()
        while progress.chunk < self.chunks:
            start = time.perf_counter()
            self._train_chunk()
            progress.seconds += time.perf_counter() - start
            bar.set_postfix(loss=f"{progress.loss / max(1, progress.count):.4f}", refresh=False)
            bar.update()
            if time.monotonic() - saved > SAVE_EVERY:
                self.save()
                saved = time.monotonic()
            if self.stop.asked:
                return

    def _bar(self) -> Progress:
        """Of all chunks of this training and those like it; fewer where the loss stops falling."""
        part, parts = self.part
        whole = self.stopping.epochs * self.chunks
        done = self.progress.epoch * self.chunks + self.progress.chunk
        return Progress(
            desc=self._title,
            total=parts * whole,
            initial=(part - 1) * whole + done,
            unit="chunk",
            quiet=self.quiet,
        )

    @property
    def _title(self) -> str:
        part, parts = self.part
        return f"half {part} of {parts}" if parts > 1 else "training"

    def _train_chunk(self) -> None:
        progress, loss = self.progress, 0.0
        epochs = progress.epoch + progress.chunk / self.chunks
        for group in self._optimiser.param_groups:
            group["lr"] = self.descent.learning_rate_at(epochs / self.stopping.epochs)
        for batch in self.batches(progress.epoch, progress.chunk):
            loss += self.step(batch)
            progress.count += len(batch.inputs)
            progress.steps += 1
            self.average.add(self.network, progress.steps)
        if not math.isfinite(loss):
            message = "the loss is no longer a number"
            raise ConfigError("descent.learning_rate", message, "give a lower one")
        progress.loss += loss
        progress.chunk += 1

    def step(self, batch: Batch) -> float:
        """One step down the mean loss of a batch; returns the loss summed over the batch."""
        self._optimiser.zero_grad(set_to_none=False)
        with torch.autocast("cpu", torch.bfloat16, self.descent.precision == "bfloat16"):
            loss = self.loss(self.network, batch)
        (loss / len(batch.inputs)).backward()
        self._optimiser.step()
        return float(loss.detach())

    def _end_epoch(self) -> None:
        """Log an epoch and decide whether it was the last."""
        progress = self.progress
        row = {
            "round": 1,
            "epoch": progress.epoch + 1,
            "loss": progress.loss / max(1, progress.count),
            "samples": progress.count,
            "learning_rate": self._optimiser.param_groups[0]["lr"],
            "seconds": round(progress.seconds, 1),
        }
        fall = progress.rows[-1]["loss"] - row["loss"] if progress.rows else math.inf
        progress.rows.append(row)
        progress.epoch += 1
        progress.chunk, progress.loss, progress.count, progress.seconds = 0, 0.0, 0, 0.0
        plateau = self.stopping.rule == "plateau" and fall <= self.stopping.min_delta
        progress.finished = plateau or progress.epoch >= self.stopping.epochs
        self.folder.write_log(progress.rows)
        if not self.quiet:
            change = f" ({-fall:+.4f})" if math.isfinite(fall) else ""
            text = (
                f"roadtorch: {self._title}, epoch {row['epoch']} of {self.stopping.epochs}: "
                f"loss {row['loss']:.4f}{change}, {row['samples']} samples in "
                f"{row['seconds']:.0f} s"
            )
            Progress.write(text, file=sys.stderr)
