"""The samples of networks for whole pictures: varied pictures with their targets. Ours."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.layout.normalisation import normalise
from roadtorch.layout.picture_network import OUTPUTS
from roadtorch.train.arrays import from_bytes, read_arrays
from roadtorch.train.batches import Batch
from roadtorch.train.config import PictureTraining
from roadtorch.train.generators import PICTURE_ORDER, VARIATION, generator_at
from roadtorch.train.processes import Processes
from roadtorch.train.targets import targets_of
from roadtorch.train.variation import draw_frames, reframed, relit


class PictureSamples:
    """Prepared pictures in varied batches; a chunk is one batch.

    files: image and teacher's maps. labels: the last network's maps, in the same order; none in
    the first round.
    """

    def __init__(
        self,
        files: Sequence[Path],
        labels: Sequence[Path],
        number: int,
        training: PictureTraining,
        processes: Processes,
    ) -> None:
        self._files, self._labels, self._round = files, labels, number
        self._training, self._processes = training, processes

    @property
    def chunks(self) -> int:
        """Batches of one epoch."""
        return max(1, round(len(self._files) / self._training.descent.batch))

    def batches(self, epoch: int, chunk: int) -> Iterator[Batch]:
        """This process's pictures of one batch. Targets are the ``Targets``, six planes.

        All processes draw the variation of all pictures, and each takes its own.
        """
        training, place = self._training, (self._round, epoch)
        order = torch.randperm(
            len(self._files), generator=generator_at(training.random_seed, PICTURE_ORDER, *place)
        )
        members = order.tensor_split(self.chunks)[chunk].tolist()
        size = (training.network.height, training.network.width)
        generator = generator_at(training.random_seed, VARIATION, *place, chunk)
        frames = draw_frames(len(members), size, training.shift, generator)
        seeds = torch.randint(2**62, (len(members),), generator=generator).tolist()
        mine = self._processes.share(range(len(members)))
        parts = [self._one(members[i], frames[i : i + 1], seeds[i]) for i in mine]
        if parts:
            images, targets = (torch.cat(maps) for maps in zip(*parts, strict=True))
        else:
            images, targets = torch.empty(0, 3, *size), torch.empty(0, OUTPUTS + 2, *size)
        yield Batch(images, targets, torch.ones(len(images)), len(members))

    def _one(self, member: int, frame: Tensor, seed: int) -> tuple[Tensor, Tensor]:
        """One varied picture (1,3,H,W), normalised, and its targets (1,6,H,W)."""
        training = self._training
        arrays = read_arrays(self._files[member], "image", "maps")
        arrays = {name: from_bytes(values)[None] for name, values in arrays.items()}
        network = None
        if self._labels:
            network = from_bytes(read_arrays(self._labels[member], "maps")["maps"])[None]
        targets = targets_of(arrays["maps"], network, training.teacher, training.rounds)
        seen = reframed(torch.cat(targets, 1), frame, "zeros")
        image = reframed(arrays["image"], frame, "border")
        image = relit(image, training.light, torch.Generator().manual_seed(seed))
        return normalise(image[0], training.network.normalisation).pixels[None], seen
