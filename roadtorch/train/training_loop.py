"""The training loop, independent of the network: samples, steps, epochs, checkpoints."""

import copy
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from roadtorch.base.errors import DivergedError, WeightsError
from roadtorch.base.progress import Progress
from roadtorch.base.signals import StopRequest
from roadtorch.data.corrections import HumanLabels
from roadtorch.inputs.item import Item
from roadtorch.layout.weights import LayoutNetwork, load_tensors
from roadtorch.run.memo import Arrays
from roadtorch.train.config import Descent, Stopping
from roadtorch.train.run_folder import BAD_CHECKPOINT, CHECKPOINT, LABELS, RunFolder
from roadtorch.train.source import SourceImage

# --- randomness -------------------------------------------------------------------------


PATCH_ORDER, CENTRES, PATCH_VARIATION, IMAGE_ORDER, IMAGE_VARIATION = range(5)
"""First numbers of generators' keys: each use of random numbers has its own generators."""


def make_generator(seed: int, *key: int) -> torch.Generator:
    """Return the generator of a seed and a key (use, epoch, chunk, …).

    It depends on nothing else, so a resumed run samples as the uninterrupted one would.
    """
    state = np.random.SeedSequence([seed, *key]).generate_state(1, np.uint64)[0]
    return torch.Generator().manual_seed(int(state >> np.uint64(1)))


@contextmanager
def seed_torch(seed: int, *key: int) -> Iterator[None]:
    """Seed torch's global generator within the block, and restore it afterwards."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(make_generator(seed, *key).initial_seed())
        yield


# --- steps and epochs -------------------------------------------------------------------


SAVE_INTERVAL = 60.0  # seconds of work that a power failure may cost


class TrainingInputs(NamedTuple):
    """The inputs of a training.

    files: prepared images. corrected: copies with corrections of some of them. initial: network
    with the initial weights, if any. out: folder of the run, for labels by a network. number: of
    the round, from 1.
    """

    files: Sequence[Path]
    corrected: Mapping[Path, Path]
    initial: LayoutNetwork | None
    out: Path
    number: int = 1
    device: str = "cpu"

    @property
    def labels(self) -> Path:
        """Folder of the network's labels for this round."""
        return self.out / f"{LABELS}{self.number}"


class Batch(NamedTuple):
    """The samples of one step: network inputs (n, …), and the loss's targets."""

    inputs: Tensor
    targets: Tensor


@dataclass
class TrainingProgress:
    """The progress of a run, from which it is resumed with the weights and the optimizer's state.

    epoch, chunk, steps, finished: of the current round. loss, count: sums over the finished part
    of the epoch. rows: the finished epochs of all rounds.
    """

    round: int = 1
    epoch: int = 0
    chunk: int = 0
    steps: int = 0
    loss: float = 0.0
    count: int = 0
    seconds: float = 0.0
    finished: bool = False
    rows: list[dict[str, Any]] = field(default_factory=list)

    @property
    def losses(self) -> list[float]:
        """Losses of the finished epochs of this round."""
        return [row["loss"] for row in self.rows if row["round"] == self.round]


class Recipe:
    """A kind of training: what the loop does in each of its rounds. Most have one.

    loss: of a network, summed over a batch. source: images with a renderer's truth.
    """

    loss: Callable[[Any, Batch], Tensor]
    source: Sequence[SourceImage] = ()
    rounds = 1

    def __init__(self, descent: Descent, stopping: Stopping) -> None:
        self._rules = descent, stopping

    def survey(self, images: Sequence[Item], folder: Path, stop: StopRequest, quiet: bool) -> None:
        """Find what the preparation of an image needs of others, cached in ``folder``."""

    def correct(self, prepared: Arrays, correction: HumanLabels) -> Arrays:
        """Return a prepared image with a correction; without, where corrections are refused."""
        return prepared

    def rules(self, number: int) -> tuple[Descent, Stopping]:
        """Return the descent and the end of a round."""
        return self._rules

    def parameter_groups(self, network: nn.Module, number: int) -> list[dict[str, Any]]:
        """Return the parameters that learn in a round: ``params``, and ``factor`` on their rate."""
        return [{"params": list(network.parameters()), "factor": 1.0}]

    def initialise(self, network: nn.Module, samples: Any) -> None:
        """Set what depends on samples in a new network, before the first round."""

    def finish_round(self, network: LayoutNetwork, out: Path, number: int) -> LayoutNetwork:
        """Write the results of a round with its averaged network; return that of the run so far."""
        return network


WARM_UP_STEPS = 10
"""Warm-up of the average: after n steps the decay is at most n / (n + this)."""


@dataclass
class Loop:
    """The epochs of a round: a network, its averaged copy and their progress.

    samples: of the recipe: ``chunks``, the number of parts of an epoch, between which a run can be
    interrupted and resumed; ``batches(epoch, chunk)`` yields the batches of one, always the same.
    title: what comes before the epoch. validate: F of a network on held-out images.
    """

    network: LayoutNetwork
    recipe: Recipe
    samples: Any
    progress: TrainingProgress
    folder: RunFolder
    stop: StopRequest
    quiet: bool = False
    title: str = ""
    device: str = "cpu"
    validate: Callable[[Any], float] | None = None

    def __post_init__(self) -> None:
        """Move the network to the device; create its average and the optimizer."""
        number = self.progress.round
        self.descent, self.stopping = self.recipe.rules(number)
        self.network.to(self.device)
        self.average = copy.deepcopy(self.network)
        self.best = self.average.state_dict()  # the current weights, without ``validate``
        descent, groups = self.descent, self.recipe.parameter_groups(self.network, number)
        rate, decay = descent.learning_rate, descent.weight_decay
        self._optimiser: torch.optim.Optimizer = (
            torch.optim.AdamW(groups, rate, weight_decay=decay)
            if descent.method == "adam"
            else torch.optim.SGD(groups, rate, descent.momentum, weight_decay=decay)
        )

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore weights and optimizer from a checkpoint; WeightsError if it lacks them."""
        path = self.folder.path / CHECKPOINT
        try:
            load_tensors(self.network, state["network"], path)
            load_tensors(self.average, state["average"], path)
            if self.validate:
                self.best = state["best"]
            self._optimiser.load_state_dict(state["optimiser"])
        except (KeyError, TypeError, ValueError, AttributeError):
            raise WeightsError(path, *BAD_CHECKPOINT) from None

    def train(self) -> None:
        """Train from ``progress`` to the last epoch, or until a stop is requested.

        Saves a checkpoint after each epoch, every ``SAVE_INTERVAL`` seconds and on a stop.
        Raises DivergedError if the loss is no longer finite.
        """
        self.network.train()
        chunks, progress = self.samples.chunks, self.progress
        with Progress(
            desc=self._title(progress.epoch + 1),
            total=self.stopping.epochs * chunks,
            initial=progress.epoch * chunks + progress.chunk,
            unit="",
            quiet=self.quiet,
        ) as bar:
            while not progress.finished and not self.stop.requested:
                self._train_epoch(bar)
                if progress.chunk == chunks:
                    self._end_epoch()
            self.save()

    def save(self) -> None:
        """Write the checkpoint."""
        self.folder.write_checkpoint(
            {
                "network": self.network.state_dict(),
                "average": self.average.state_dict(),
                **({"best": self.best} if self.validate else {}),
                "optimiser": self._optimiser.state_dict(),
                "progress": asdict(self.progress),
            }
        )

    def _train_epoch(self, bar: Progress) -> None:
        """Train the remaining chunks of an epoch; return after a chunk if a stop is requested."""
        progress, saved = self.progress, time.monotonic()
        while progress.chunk < self.samples.chunks:
            start = time.perf_counter()
            self._train_chunk()
            progress.seconds += time.perf_counter() - start
            bar.set_description_str(self._title(progress.epoch + 1), refresh=False)
            bar.set_postfix(loss=f"{progress.loss / max(1, progress.count):.4f}", refresh=False)
            bar.update()
            if time.monotonic() - saved > SAVE_INTERVAL:
                self.save()
                saved = time.monotonic()
            if self.stop.requested:
                return

    def _title(self, epoch: int) -> str:
        return f"{self.title}epoch {epoch} of {self.stopping.epochs}"

    def _rate_of(self, chunk: int) -> float:
        epochs = self.progress.epoch + chunk / self.samples.chunks
        return self.descent.learning_rate_at(epochs / self.stopping.epochs)

    def _train_chunk(self) -> None:
        progress, loss = self.progress, 0.0
        rate = self._rate_of(progress.chunk)
        for group in self._optimiser.param_groups:
            group["lr"] = rate * group["factor"]
        for batch in self.samples.batches(progress.epoch, progress.chunk):
            loss += self.step(batch)
            progress.count += len(batch.inputs)
            progress.steps += 1
            self._update_average()
        if not math.isfinite(loss):
            message = "the loss is no longer finite"
            raise DivergedError("descent.learning_rate", message, "lower it")
        progress.loss += loss
        progress.chunk += 1

    @torch.no_grad()
    def _update_average(self) -> None:
        """Update the moving average of the weights (Polyak and Juditsky 1992)."""
        steps = self.progress.steps
        decay = min(self.descent.ema, steps / (steps + WARM_UP_STEPS))
        means, weights = (part.state_dict() for part in (self.average, self.network))
        for name, mean in means.items():
            if mean.is_floating_point():  # not a count of batches
                mean.lerp_(weights[name], 1 - decay)

    def step(self, batch: Batch) -> float:
        """Take one step down the mean loss of a batch; return the loss summed over the batch."""
        self._optimiser.zero_grad(set_to_none=False)
        batch = Batch(*(part.to(self.device) for part in batch))
        loss = self.recipe.loss(self.network, batch)
        (loss / len(batch.inputs)).backward()
        self._optimiser.step()
        return float(loss.detach())

    def _end_epoch(self) -> None:
        """Log an epoch and decide whether it was the last."""
        progress = self.progress
        row = {
            "round": progress.round,
            "epoch": progress.epoch + 1,
            "loss": progress.loss / max(1, progress.count),
            "samples": progress.count,
            "learning_rate": self._rate_of(self.samples.chunks - 1),
            "seconds": round(progress.seconds, 1),
        }
        progress.rows.append(row)
        progress.epoch += 1
        progress.chunk, progress.loss, progress.count, progress.seconds = 0, 0.0, 0, 0.0
        losses = progress.losses
        progress.finished = self.stopping.is_reached(losses)
        if self.validate:
            row["held_out_f"] = round(self.validate(self.average.eval()), 5)
            scores = [entry["held_out_f"] for entry in progress.rows]
            best_epoch = scores.index(max(scores)) + 1
            if best_epoch == progress.epoch:
                self.best = copy.deepcopy(self.average.state_dict())
            progress.finished |= progress.epoch - best_epoch >= self.stopping.patience
        self.folder.write_log(progress.rows)
        if not self.quiet:
            change = f" ({-(losses[-2] - losses[-1]):+.4f})" if len(losses) > 1 else ""
            speed = f"{row['samples']} samples in {row['seconds']:.0f} s"
            title = self._title(row["epoch"])
            text = f"roadtorch: {title}: loss {row['loss']:.4f}{change}, {speed}"
            text += f", held-out F {row['held_out_f']:.3f}" if self.validate else ""
            Progress.write(text, file=sys.stderr)
