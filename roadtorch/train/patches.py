"""Training of patch networks: centres, augmentation and loss of patches.

P2, sections 3.1 and 6.1: at the centroid of each superpixel and around it, where the labeller is
certain; at a random scale and angle, with Gaussian noise; squared error; no hard examples.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.errors import InputError
from roadtorch.base.signals import StopRequest
from roadtorch.imaging.resize import resize_to_work
from roadtorch.imaging.segments import segment_mean, segment_size
from roadtorch.inputs.item import Item
from roadtorch.layout.classes import NUM_CLASSES, UNLABELLED
from roadtorch.layout.labeller import label_layout
from roadtorch.layout.patch_network import FIXED_GAIN, normalise
from roadtorch.run.memo import Arrays, cache_key, make_cached_reader, read_arrays
from roadtorch.train.config import PatchCentres, PatchTraining
from roadtorch.train.effects import uniform
from roadtorch.train.prepared import from_uint8, to_uint8
from roadtorch.train.training_loop import (
    CENTRES,
    PATCH_ORDER,
    PATCH_VARIATION,
    Batch,
    Recipe,
    TrainingInputs,
    make_generator,
)

# --- centres ----------------------------------------------------------------------------


def find_centres(segments: Tensor, settings: PatchCentres) -> Tensor:
    """Return the centroids of segments (H, W) and points around them: rows, columns, int64 (n, 2).

    The points are at equal angles, the first below the centroid, and clamped to the image.
    """
    height, width = segments.shape
    coordinates = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    size = segment_size(segments, int(segments.max()) + 1)
    centroid = segment_mean(torch.stack(coordinates).to(torch.float32), segments, size).T
    turns = torch.arange(settings.extra) * (2 * math.pi / max(1, settings.extra))
    circle = torch.stack([turns.cos(), turns.sin()], 1) * settings.radius
    moves = torch.cat([torch.zeros(1, 2), circle])
    centres = (centroid[:, None] + moves).reshape(-1, 2).round().to(torch.int64)
    return centres.clamp_min(0).minimum(torch.tensor([height - 1, width - 1]))


def label_centres(image: Tensor, labels: Tensor, training: PatchTraining) -> Arrays:
    """Return an image (3, h, w) at working size with the centres of its patches and their labels.

    labels: int64 (h, w), 255 where there is none; centres there are left out. Returns image: uint8
    (3, h, w); centres: row and column, int16 (n, 2); classes: uint8 (n,).
    """
    centres = find_centres(training.superpixels.cut(image), training.centres)
    classes = labels[centres[:, 0], centres[:, 1]]
    is_labelled = classes != UNLABELLED
    return {
        "image": to_uint8(image),
        "centres": centres[is_labelled].to(torch.int16),
        "classes": classes[is_labelled].to(torch.uint8),
    }


# --- extraction -------------------------------------------------------------------------


SCALE, MAX_TURN, NOISE_LEVELS = (0.6, 1.4), math.radians(17), (0.3, 1.2)
"""Magnification, largest rotation and standard deviation of noise. P2, section 6.1.

P2 gives no unit for its noise. Here it is grey levels of 0…255: "noisy acquisition" is the noise of
a sensor, about one level; 0.3 to 1.2 standard deviations of the image would drown it."""

NOISE_PATCHES = 256
"""Noise patches sampled for a chunk; each patch uses one, scaled by its own deviation."""


class Variation(NamedTuple):
    """Random variation of n patches.

    centre: row and column, (n, 2). scale: magnification. turn: rotation, radians. noise: standard
    deviation in grey levels of 255. noise_patch: index of the patch of noise, int64.
    """

    centre: Tensor
    scale: Tensor
    turn: Tensor
    noise: Tensor
    noise_patch: Tensor


def sample_variation(centre: Tensor, generator: torch.Generator) -> Variation:
    """Sample scales, angles and noise of patches at centres (n, 2)."""
    count = len(centre)
    return Variation(
        centre.to(torch.float32),
        uniform(generator, count, *SCALE),
        uniform(generator, count, -MAX_TURN, MAX_TURN),
        uniform(generator, count, *NOISE_LEVELS),
        torch.randint(NOISE_PATCHES, (count,), generator=generator),
    )


def sample_noise(patch: int, generator: torch.Generator) -> Tensor:
    """Sample the noise of a chunk, standard normal, shape (NOISE_PATCHES, 3, P, P)."""
    return torch.randn(NOISE_PATCHES, 3, patch, patch, generator=generator)


def sample_patches(pixels: Tensor, params: Variation, patch: int) -> Tensor:
    """Extract patches (n, 3, P, P) from an image (3, H, W), bilinear, reflected at the border.

    Each has P/2 pixels before its centre and P/2 - 1 after it, as in ``PatchNetwork``.
    """
    count, (height, width) = len(params.centre), pixels.shape[-2:]
    offsets = torch.arange(patch, dtype=torch.float32) - patch // 2
    cos, sin = (f(params.turn) / params.scale for f in (torch.cos, torch.sin))
    grid = torch.empty(count, patch, patch, 2)
    # column = sin·down + cos·across, row = cos·down - sin·across
    for axis, (down, across, length) in enumerate(((sin, cos, width), (cos, -sin, height))):
        unit = 2 / max(1, length - 1)  # from pixels to -1 (first) … 1 (last)
        start = params.centre[:, 1 - axis] * unit - 1
        down = down[:, None] * offsets * unit + start[:, None]
        across = across[:, None] * offsets * unit
        torch.add(down[:, :, None], across[:, None, :], out=grid[..., axis])
    grid = grid.reshape(1, count * patch, patch, 2)
    cut = F.grid_sample(pixels[None], grid, padding_mode="reflection", align_corners=True)
    return cut.reshape(3, count, patch, patch).transpose(0, 1)


def add_noise(
    patches: Tensor, params: Variation, noise: Tensor, out: Tensor | None = None
) -> Tensor:
    """Add noise to normalised patches (n, 3, P, P)."""
    deviation = (params.noise * (FIXED_GAIN / 255))[:, None, None, None]
    return torch.addcmul(patches, noise.index_select(0, params.noise_patch), deviation, out=out)


# --- samples ----------------------------------------------------------------------------


EXTRACTION_BLOCK = 128
"""Patches extracted at a time, so that intermediate results stay in the cache."""


class PatchChunk(NamedTuple):
    """The patches of a chunk, before they are extracted, image by image."""

    members: list[int]  # indices of the prepared files
    counts: list[int]  # patches of each of them
    params: Variation
    noise: Tensor  # of ``sample_noise``
    classes: Tensor  # (n,)
    steps: tuple[Tensor, ...]  # the patches of each step


class PatchSamples:
    """Patches of prepared images, shuffled over ``shuffle_images`` of them at a time.

    A chunk is one ``passes``-th of the patches of that many images. Memory does not grow with the
    number of images.
    """

    def __init__(self, files: Sequence[Path], training: PatchTraining) -> None:
        self._files, self._training = files, training
        self._read = make_cached_reader()
        if not any(len(read_arrays(file, "classes")["classes"]) for file in files):
            message = "have no superpixel with a certain label"
            hint = "lower labeller.margin, or give street images"
            raise InputError("the images", message, hint)
        self._groups = -(-len(files) // training.shuffle_images)
        patch = training.network.topology.patch
        self._buffer = torch.empty(0, 3, patch, patch)  # fresh memory is as slow as extraction

    @property
    def chunks(self) -> int:
        """Chunks of an epoch: groups of images, each visited ``passes`` times."""
        return self._groups * self._training.passes

    def sample_chunk(self, epoch: int, chunk: int) -> PatchChunk:
        """Sample the patches of a chunk and their order."""
        training = self._training
        visit, group = divmod(chunk, self._groups)
        order = self._permute(len(self._files), PATCH_ORDER, epoch, visit)
        members = order[group * training.shuffle_images :][: training.shuffle_images].tolist()
        labelled = [self._read_centres(member, epoch, visit) for member in members]
        generator = make_generator(training.random_seed, PATCH_VARIATION, epoch, chunk)
        centres, classes = (torch.cat(parts) for parts in zip(*labelled, strict=True))
        params = sample_variation(centres, generator)
        noise = sample_noise(training.network.topology.patch, generator)
        shuffled = torch.randperm(len(classes), generator=generator)
        steps = shuffled.tensor_split(max(1, round(len(classes) / training.descent.batch)))
        counts = [len(part) for part, _ in labelled]
        return PatchChunk(members, counts, params, noise, classes.long(), steps)

    def batches(self, epoch: int, chunk: int) -> Iterator[Batch]:
        """Yield the patches of a chunk in batches of nearly the same size."""
        sampled = self.sample_chunk(epoch, chunk)
        self._fill_buffer(sampled)
        for step in sampled.steps:
            if len(step):
                yield Batch(self._buffer.index_select(0, step), sampled.classes[step])

    def _fill_buffer(self, chunk: PatchChunk) -> None:
        """Fill the buffer with the patches of a chunk."""
        patch, start = self._training.network.topology.patch, 0
        if len(self._buffer) < len(chunk.classes):
            self._buffer = torch.empty(len(chunk.classes), 3, patch, patch)
        for member, count in zip(chunk.members, chunk.counts, strict=True):
            image = from_uint8(self._read(self._files[member], "image")["image"])
            pixels = normalise(image, self._training.network.normalisation)
            for first in range(start, start + count, EXTRACTION_BLOCK):
                block = slice(first, min(first + EXTRACTION_BLOCK, start + count))
                part = Variation(*(values[block] for values in chunk.params))
                patches = sample_patches(pixels, part, patch)
                add_noise(patches, part, chunk.noise, self._buffer[block])
            start += count

    def _read_centres(self, member: int, epoch: int, visit: int) -> tuple[Tensor, Tensor]:
        """Return centres and classes of an image's patches at one visit in an epoch."""
        arrays = self._read(self._files[member])
        count = len(arrays["classes"])
        order = self._permute(count, CENTRES, epoch, member)[visit :: self._training.passes]
        return arrays["centres"][order], arrays["classes"][order]

    def _permute(self, count: int, *key: int) -> Tensor:
        return torch.randperm(count, generator=make_generator(self._training.random_seed, *key))


def squared_error(network: nn.Module, batch: Batch) -> Tensor:
    """Sum |potentials - one-hot|² over patches. P2, section 3.1."""
    one_hot = F.one_hot(batch.targets, NUM_CLASSES).to(batch.inputs)
    return (network(batch.inputs) - one_hot).square().sum()


# --- recipe ----------------------------------------------------------------------------


class PatchRecipe(Recipe):
    """Training of CNN-7 and its family on patches."""

    loss = staticmethod(squared_error)

    def __init__(self, training: PatchTraining) -> None:
        super().__init__(training.descent, training.stopping)
        self._training = training
        parts = training.model_dump(include={"superpixels", "labeller", "centres"})
        self.preparation = {**parts, "working": training.network.working.model_dump()}

    def key(self, image: Item) -> str:
        """Return the cache key of a prepared image."""
        return cache_key(self.preparation, image.path)

    def prepare(self, image: Tensor, name: str) -> Arrays:
        """Resize an image (3, H, W) and label its patches: see ``label_centres``."""
        training, working = self._training, self._training.network.working
        small = resize_to_work(image, working)
        layout = label_layout(small, training.labeller, working, training.superpixels)
        return label_centres(small, layout.labels, training)

    def make_samples(self, inputs: TrainingInputs, stop: StopRequest, quiet: bool) -> PatchSamples:
        """Return the augmented patches of prepared images."""
        return PatchSamples(inputs.files, self._training)
