"""The samples of patch networks: patches of prepared pictures, shuffled, with their error.

P2, section 3.1: squared error to the label; no hard examples.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.layout.classes import CLASSES
from roadtorch.layout.normalisation import normalise
from roadtorch.train.arrays import from_bytes, kept_arrays, read_arrays
from roadtorch.train.batches import Batch
from roadtorch.train.config import PatchTraining
from roadtorch.train.corrections import LabelledSites, corrected_sites
from roadtorch.train.generators import JITTER, PATCH_ORDER, SITES, generator_at
from roadtorch.train.patches import Draw, add_noise, cut_patches, draw_jitter, draw_noise
from roadtorch.train.processes import Processes
from roadtorch.train.sites import class_weights

BLOCK = 128
"""Patches cut at a time: what is made on the way stays in the cache."""


class PatchSamples:
    """The patches of prepared pictures, shuffled over ``mix`` pictures at a time.

    One chunk holds the patches of ``mix`` pictures, at each visit another part of them: about
    ``mix`` / ``passes`` pictures' worth of memory, and what ``kept_arrays`` keeps, however many
    pictures there are.
    """

    def __init__(
        self,
        files: Sequence[Path],
        training: PatchTraining,
        processes: Processes,
        said: Mapping[Path, Path] = MappingProxyType({}),
    ) -> None:
        self._files, self._said = files, said
        self._training = training
        self._processes = processes
        self._read = kept_arrays()
        self._weights = class_weights(files, training)
        self._groups = -(-len(files) // training.mix)
        patch = training.network.topology.patch
        self._room = torch.empty(0, 3, patch, patch)  # kept: fresh memory costs as much as cutting

    @property
    def chunks(self) -> int:
        """Chunks of one epoch: groups of pictures, each visited ``passes`` times."""
        return self._groups * self._training.passes

    def batches(self, epoch: int, chunk: int) -> Iterator[Batch]:
        """This process's patches of a chunk, in batches that are nearly the same size."""
        training = self._training
        visit, group = divmod(chunk, self._groups)
        order = self._shuffled(len(self._files), PATCH_ORDER, epoch, visit)
        members = order[group * training.mix :][: training.mix].tolist()
        sites = [self._sites_of(member, epoch, visit) for member in members]
        generator = generator_at(training.random_seed, JITTER, epoch, chunk)
        centres, classes, counts = (torch.cat(parts) for parts in zip(*sites, strict=True))
        draw = draw_jitter(centres, training.jitter, generator)
        noises = draw_noise(training.network.topology.patch, generator)
        shuffled = torch.randperm(len(classes), generator=generator)
        steps = shuffled.tensor_split(max(1, round(len(classes) / training.descent.batch)))
        picture = torch.arange(len(members)).repeat_interleave(
            torch.tensor([len(part) for _, part, _ in sites])
        )
        mine = torch.cat([self._mine(step) for step in steps])
        by_picture = picture[mine].argsort(stable=True)
        self._cut(members, picture[mine[by_picture]], draw.at(mine[by_picture]), noises)
        place, at = by_picture.argsort(), 0
        for step in steps:
            count = len(self._mine(step))
            own = mine[at : at + count]
            targets = classes[own].long()
            part = self._room.index_select(0, place[at : at + count])
            if len(step):
                yield Batch(part, targets, self._weights[targets] * counts[own], len(step))
            at += count

    def _cut(self, members: list[int], picture: Tensor, draw: Draw, noises: Tensor) -> None:
        """Fill the first n rooms with the patches of ``draw``; picture: (n,), ascending."""
        network = self._training.network
        patch = network.topology.patch
        if len(self._room) < len(picture):
            self._room = torch.empty(len(picture), 3, patch, patch)
        for number, member in enumerate(members):
            image = from_bytes(self._read(self._files[member], "image")["image"])
            pixels, gain = normalise(image, network.normalisation)
            for index in (picture == number).nonzero()[:, 0].split(BLOCK):
                if len(index):
                    own, room = draw.at(index), self._room[index[0] : index[-1] + 1]
                    add_noise(cut_patches(pixels, own, patch), own, noises, gain, room)

    def _sites_of(self, member: int, epoch: int, visit: int) -> tuple[Tensor, Tensor, Tensor]:
        """Centres (n,2), classes and weights (n,) of one picture at one visit in an epoch."""
        arrays = self._read(self._files[member], "sites", "classes")
        sites = LabelledSites(arrays["sites"], arrays["classes"], torch.ones(len(arrays["sites"])))
        if (said := self._said.get(self._files[member])) is not None:
            planes = read_arrays(said, "layout", "known")
            sites = corrected_sites(sites, planes, self._training.corrections.weight)
        order = self._shuffled(len(sites.classes), SITES, epoch, member)
        order = order[visit :: self._training.passes]
        return sites.centres[order], sites.classes[order], sites.weights[order]

    def _mine(self, step: Tensor) -> Tensor:
        return step[self._processes.rank :: self._processes.size]

    def _shuffled(self, count: int, *place: int) -> Tensor:
        return torch.randperm(count, generator=generator_at(self._training.random_seed, *place))


def squared_error(network: nn.Module, batch: Batch) -> Tensor:
    """Sum over patches of |potentials - one-hot|², each patch times its weight. P2, section 3.1."""
    wanted = F.one_hot(batch.targets, CLASSES).to(batch.inputs)
    return ((network(batch.inputs) - wanted).square().sum(1) * batch.weights).sum()
