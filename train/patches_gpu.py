"""Train patch networks side by side on a GPU, with the samples of ``roadtorch train``.

One CNN-7 of 6,099 weights keeps no GPU busy, so all take their steps at once, their weights in one
tensor and a step in a CUDA graph. Random numbers, order, loss and stopping rule are those of one
core; rounding is the GPU's.
"""

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F
from torch.nn.utils import parameters_to_vector, vector_to_parameters
from torch.nn.utils.rnn import pad_sequence

from roadtorch.base.signals import stop_on_signals
from roadtorch.base.version import __version__
from roadtorch.inputs.images import find_images
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.layout.patch_network import NormalisedImage, PatchNetwork
from roadtorch.layout.weights import save_network
from roadtorch.run.memo import read_arrays
from roadtorch.train.config import PatchTraining, as_values
from roadtorch.train.patches import (
    PatchChunk,
    PatchRecipe,
    PatchSamples,
    Variation,
    add_noise,
    sample_patches,
)
from roadtorch.train.run import prepare_folder
from roadtorch.train.run_folder import WEIGHTS, RunFolder


@dataclass
class Student:
    """A network in training. rows: its finished epochs. loss, count: sums of the current one."""

    folder: Path
    training: PatchTraining
    files: Sequence[Path]
    samples: PatchSamples
    network: PatchNetwork
    rows: list[dict[str, Any]] = field(default_factory=list)
    chunk: int = 0
    loss: float = 0.0
    count: int = 0
    finished: bool = False

    @property
    def learning_rate(self) -> float:
        """Learning rate of the next chunk."""
        epochs = len(self.rows) + self.chunk / self.samples.chunks
        return self.training.descent.learning_rate_at(epochs / self.training.stopping.epochs)

    def sample_chunk(self) -> PatchChunk:
        """Sample the next chunk."""
        epoch, chunk = divmod(self.chunk, self.samples.chunks)
        return self.samples.sample_chunk(len(self.rows) + epoch, chunk)

    def end_chunk(self, loss: float) -> None:
        """Add a chunk's loss; at an epoch's end log it, apply the stopping rule and write."""
        self.loss += loss
        if self.chunk < self.samples.chunks:
            return
        mean, epoch = self.loss / self.count, len(self.rows) + 1
        self.rows.append({"round": 1, "epoch": epoch, "loss": mean, "samples": self.count})
        self.chunk, self.count, self.loss = 0, 0, 0.0
        is_reached = self.training.stopping.is_reached([row["loss"] for row in self.rows])
        self.finished = is_reached or not math.isfinite(mean)
        self.write()

    def write(self) -> None:
        """Write the weights and the losses."""
        config = as_values(self.training)
        origin = {"roadtorch": __version__, "config": config, "epochs": len(self.rows)}
        origin = {**origin, "finished": self.finished, "trained on": "GPU"}
        save_network(self.folder / WEIGHTS, self.network, origin)
        RunFolder(self.folder).write_log(self.rows)
        if self.finished:
            (self.folder / "done").touch()


def prepare_files(training: PatchTraining, images: str, prepared: Path) -> list[Path]:
    """Prepare the images of a training, and return their files."""
    with stop_on_signals() as stop:
        parts = (PatchRecipe(training), find_images([images]), prepared, stop)
        items = prepare_folder(*parts, quiet=True)
    return [item.file for item in items if item.file is not None]


def make_student(folder: Path, training: PatchTraining, files: Sequence[Path]) -> Student:
    """Make the network of a training and its samples."""
    folder.mkdir(parents=True, exist_ok=True)
    network = PatchRecipe(training).make_network(None)
    assert isinstance(network, PatchNetwork)
    return Student(folder, training, files, PatchSamples(files, training), network)


def buffer_size(student: Student) -> tuple[int, int]:
    """Return the most patches that a chunk of a student can have, and a step of it."""
    training, batch = student.training, student.training.descent.batch
    counts = sorted(len(read_arrays(file, "classes")["classes"]) for file in student.files)
    last = len(counts) % training.shuffle_images or training.shuffle_images
    steps = max(1, round(sum(counts[:last]) / batch))
    return sum(counts[-training.shuffle_images :]), batch + math.ceil(batch / (2 * steps)) + 1


# --- networks in one tensor -----------------------------------------------------------------


def convolve_grouped(maps: Tensor, kernels: Tensor) -> Tensor:
    """Convolve maps (N, B, C, H, W) with kernels (N, K, C, S, S) of N networks, in groups."""
    count = len(maps)
    grouped = maps.transpose(0, 1).flatten(1, 2)
    result = F.conv2d(grouped, kernels.flatten(0, 1), groups=count)
    return result.unflatten(1, (count, -1)).transpose(0, 1)


def convolve_unfolded(maps: Tensor, kernels: Tensor) -> Tensor:
    """Convolve maps (N, B, C, H, W) with kernels (N, K, C, S, S) as a product of matrices."""
    batch, (height, width), size = maps.shape[1], maps.shape[-2:], kernels.shape[-1]
    columns = F.unfold(maps.flatten(0, 1), size)
    matrices = kernels.flatten(2).repeat_interleave(batch, 0)
    result = torch.bmm(matrices, columns).unflatten(0, maps.shape[:2])
    return result.unflatten(-1, (height - size + 1, width - size + 1))


Convolution = Callable[[Tensor, Tensor], Tensor]


class StackedNetworks:
    """The weights of N networks of CNN-7's kind and one topology in a tensor (N, weights)."""

    convolve: Convolution = staticmethod(convolve_unfolded)

    def __init__(self, networks: Sequence[PatchNetwork], device: torch.device) -> None:
        self.networks = networks
        self._shapes = [weight.shape for weight in networks[0].parameters()]
        vectors = [parameters_to_vector(network.parameters()) for network in networks]
        self.weights = torch.stack(vectors).detach().to(device).requires_grad_()

    def potentials(self, patches: Tensor) -> Tensor:
        """Return potentials (N, B, 3) of patches (N, B, 3, P, P), as ``PatchNetwork.forward``."""
        parts = self.weights.split([shape.numel() for shape in self._shapes], 1)
        count = len(self.networks)
        parts = [part.view(count, *shape) for part, shape in zip(parts, self._shapes, strict=True)]
        maps = self._layer(patches, parts[0], parts[1]).tanh()
        maps = F.avg_pool2d(maps.flatten(0, 1), 2).unflatten(0, maps.shape[:2])
        maps = self._layer(maps, parts[2], parts[3]).tanh()
        return self._layer(maps, parts[4], parts[5]).flatten(2).sigmoid()

    def _layer(self, maps: Tensor, kernels: Tensor, bias: Tensor) -> Tensor:
        return self.convolve(maps, kernels) + bias[:, None, :, None, None]

    def store(self) -> None:
        """Copy the weights into the networks."""
        for network, vector in zip(self.networks, self.weights.detach().cpu(), strict=True):
            vector_to_parameters(vector, network.parameters())


# --- steps ------------------------------------------------------------------------------------


class Descents:
    """The steps of several networks at once.

    A step reads its patches from the network's buffer by a table of rows; -1 fills up a step, and
    a step of nothing else leaves the network as it is.
    """

    def __init__(self, students: Sequence[Student], device: torch.device) -> None:
        self._device, count = device, len(students)
        self.stack = StackedNetworks([student.network for student in students], device)
        self.patch = students[0].training.network.topology.patch
        capacity, width = map(max, zip(*map(buffer_size, students), strict=True))
        with device:
            self.buffers = torch.zeros(count, capacity, 3, self.patch, self.patch)
            self.classes = torch.zeros(count, capacity, dtype=torch.int64)
            self.counts = torch.zeros(count, capacity)
            self.table = torch.full((count, 2 * capacity // width, width), -1, dtype=torch.int64)
            self.number = torch.zeros(1, dtype=torch.int64)
            self.rate = torch.zeros(count, 1)
            self.loss = torch.zeros(count, dtype=torch.float64)
            self._offsets = (torch.arange(count) * capacity)[:, None]
            self._one_hot = torch.eye(NUM_CLASSES)
            momentum = [student.training.descent.momentum for student in students]
            self._decay = torch.tensor(momentum)[:, None] - 1
        self._velocity = torch.zeros_like(self.stack.weights)
        self._graph: Any = None
        self.steps = 0

    def clear(self) -> None:
        """Empty the table of steps, and the losses."""
        self.table.fill_(-1)
        self.loss.zero_()
        self.number.zero_()
        self.steps = 0

    def run(self) -> None:
        """Take the steps of the table."""
        if self._device.type == "cuda" and self._graph is None:
            self._choose_convolution()
        for _ in range(self.steps):
            self._step() if self._graph is None else self._graph.replay()

    def _choose_convolution(self) -> None:
        """Capture a step with each kind of convolution, on an empty table, and keep the faster."""
        table, fastest = self.table.clone(), math.inf
        self.table.fill_(-1)
        for convolve in (convolve_unfolded, convolve_grouped):
            self.stack.convolve = convolve  # of this stack alone
            graph = self._capture()
            torch.cuda.synchronize()
            start = time.monotonic()
            for _ in range(20):
                graph.replay()
            torch.cuda.synchronize()
            seconds = (time.monotonic() - start) / 20
            print(f"{convolve.__name__}: {1000 * seconds:.2f} ms a step", flush=True)
            if seconds < fastest:
                self._graph, fastest = graph, seconds
        self.number.zero_()
        self.table.copy_(table)

    def _capture(self) -> Any:
        """Capture a step in a CUDA graph."""
        warm_up = torch.cuda.Stream()
        warm_up.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(warm_up):
            for _ in range(3):
                self._step()
        torch.cuda.current_stream().wait_stream(warm_up)
        self.number.zero_()
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._step()
        return graph

    def _step(self) -> None:
        """Take a step of every network down the mean loss of its patches."""
        rows = self.table.index_select(1, self.number)[:, 0]
        is_patch = rows >= 0
        rows = rows.clamp_min(0) + self._offsets
        targets = self._one_hot[self.classes.flatten()[rows]]
        counts = self.counts.flatten()[rows] * is_patch
        potentials = self.stack.potentials(self.buffers.flatten(0, 1)[rows])
        losses = ((potentials - targets).square().sum(2) * counts).sum(1)
        mean = (losses / is_patch.sum(1).clamp_min(1)).sum()
        (gradient,) = torch.autograd.grad(mean, [self.stack.weights])
        with torch.no_grad():
            is_step = is_patch.any(1, keepdim=True)
            self._velocity.add_((self._decay * self._velocity + gradient) * is_step)
            self.stack.weights.sub_(self.rate * self._velocity * is_step)
            self.loss.add_(losses.detach())
            self.number.add_(1)


def train_side_by_side(students: Sequence[Student], device: torch.device, deadline: float) -> None:
    """Train networks to their ends, or until ``deadline`` (of time.monotonic); write each epoch.

    The CPU samples the next chunk of patches meanwhile.
    """
    images: dict[Path, NormalisedImage] = {}
    descents = Descents(students, device)
    with ThreadPoolExecutor(16, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        chunks = [pool.submit(student.sample_chunk) for student in students]
        while not all(student.finished for student in students) and time.monotonic() < deadline:
            start = time.monotonic()
            descents.clear()
            for index, student in enumerate(students):
                if not student.finished:
                    chunk = chunks[index].result()
                    load_chunk(descents, index, student, chunk, images)
                    student.count += len(chunk.classes)
                    student.chunk += 1
                    chunks[index] = pool.submit(student.sample_chunk)
            descents.run()
            descents.stack.store()
            for student, loss in zip(students, descents.loss.tolist(), strict=True):
                if not student.finished:
                    student.end_chunk(loss)
            if students[0].chunk in (1, 10):
                title = f"{students[0].folder.name}, epoch {len(students[0].rows) + 1}"
                print(f"{title}: a chunk in {time.monotonic() - start:.2f} s", flush=True)


@torch.no_grad()
def load_chunk(
    descents: Descents,
    index: int,
    student: Student,
    chunk: PatchChunk,
    images: dict[Path, NormalisedImage],
) -> None:
    """Extract the patches of a chunk into a network's buffer, and fill its table of rows."""
    device = descents.loss.device
    params = Variation(*(values.to(device) for values in chunk.params))
    noise, first = chunk.noise.to(device), 0
    sizes = torch.bincount(chunk.image, minlength=len(chunk.members)).tolist()
    for member, size in zip(chunk.members, sizes, strict=True):
        file = student.files[member]
        if file not in images:
            pixels, gain = student.samples.read_pixels(member)
            images[file] = NormalisedImage(pixels.to(device), gain)
        pixels, gain = images[file]
        part = params.select(torch.arange(first, first + size, device=device))
        target = descents.buffers[index][first : first + size]
        with device:
            add_noise(sample_patches(pixels, part, descents.patch), part, noise, gain, target)
        first += size
    descents.classes[index, :first] = chunk.classes.to(device)
    descents.counts[index, :first] = chunk.counts.to(device)
    rows = pad_sequence(list(chunk.steps), batch_first=True, padding_value=-1).to(device)
    descents.table[index, : rows.shape[0], : rows.shape[1]] = rows
    descents.steps = max(descents.steps, len(rows))
    descents.rate[index] = student.learning_rate
