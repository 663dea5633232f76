"""What a kind of network brings to its training; the run itself is the same for all."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from roadtorch.data.corrections import Correction
from roadtorch.errors import WeightsError
from roadtorch.imaging.resize import working_size
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.picture_network import PictureNetwork, network_at
from roadtorch.layout.weights import LayoutNetwork, load_network, weights_path
from roadtorch.sources.pictures import Picture
from roadtorch.train.arrays import Arrays
from roadtorch.train.batches import ErrorFunction, Samples
from roadtorch.train.config import Descent, PatchTraining, PictureTraining, Stopping, Training
from roadtorch.train.corrections import (
    corrected_shares,
    repeated,
    said_layout,
    said_planes,
)
from roadtorch.train.generators import seeded
from roadtorch.train.loop import RunContext
from roadtorch.train.patch_samples import PatchSamples, squared_error
from roadtorch.train.picture_samples import PictureSamples, Prepared
from roadtorch.train.recordings import ego_of, find_ego_cars, recording_of
from roadtorch.train.sites import prepare_patches
from roadtorch.train.targets import PictureError
from roadtorch.train.teachers import (
    label_with_network,
    lends_ego,
    load_teachers,
    prepare_picture,
)

EGO_CARS = "ego-cars"
"""The folder, beside the prepared pictures, with what recordings show of the ego car."""


class PreparedFiles(NamedTuple):
    """The prepared pictures of a run, and for those with corrections what people said."""

    files: Sequence[Path]
    said: Mapping[Path, Path]


class Recipe(Protocol):
    """A kind of training: its network, what it makes of a picture, its samples, its error."""

    rounds: int
    start: LayoutNetwork | None
    descent: Descent
    stopping: Stopping

    @property
    def error_function(self) -> ErrorFunction:
        """The summed error of a network over a batch."""
        ...

    def preparation(self) -> dict[str, Any]:
        """The settings on which ``make`` depends."""
        ...

    def survey(self, pictures: Sequence[Picture], folder: Path, context: RunContext) -> None:
        """Look at the footage as a whole, before its pictures; ``folder`` keeps what is found."""
        ...

    def make(self, image: Tensor, name: str) -> Arrays:
        """What is kept of an image (3,H,W), the picture called ``name``."""
        ...

    def shrink(self, correction: Correction) -> Arrays:
        """What is kept of a correction; samples find it by the prepared picture's file."""
        ...

    def network(self, number: int, last: LayoutNetwork | None) -> LayoutNetwork:
        """The network with which round ``number`` starts.

        last: that of the round before; in the first round ``start``.
        """
        ...

    def samples(
        self, files: PreparedFiles, number: int, last: LayoutNetwork | None, context: RunContext
    ) -> Samples:
        """The samples of round ``number``."""
        ...


class PatchRecipe:
    """CNN-7 and its family on patches; one round."""

    rounds = 1
    error_function = staticmethod(squared_error)

    def __init__(self, training: PatchTraining) -> None:
        self._training = training
        self.start = load_start(training.start, PatchNetwork(training.network))
        self.descent, self.stopping = training.descent, training.stopping

    def preparation(self) -> dict[str, Any]:
        """Working size, superpixels, labeller and sites."""
        training = self._training
        return {
            "working": training.network.working.model_dump(),
            "superpixels": training.superpixels.model_dump(),
            "labeller": training.labeller.model_dump(),
            "sites": training.sites.model_dump(),
        }

    def survey(self, pictures: Sequence[Picture], folder: Path, context: RunContext) -> None:
        """Nothing: patches are taken from single pictures."""

    def make(self, image: Tensor, name: str) -> Arrays:
        """The picture at working size, its sites and their classes."""
        return prepare_patches(image, self._training)

    def shrink(self, correction: Correction) -> Arrays:
        """The layout that people named, at working size."""
        height, width = correction.labels.shape
        size = working_size(height, width, self._training.network.working)
        return said_layout(correction, size)

    def network(self, number: int, last: LayoutNetwork | None) -> LayoutNetwork:
        """A new patch network, or the one to start from."""
        if last is not None:
            return last
        with seeded(self._training.random_seed, number):
            return PatchNetwork(self._training.network)

    def samples(
        self, files: PreparedFiles, number: int, last: LayoutNetwork | None, context: RunContext
    ) -> PatchSamples:
        """The varied patches of the pictures; corrected ones are visited more often."""
        often = repeated(files.files, files.said, self._training.corrections.share)
        return PatchSamples(often, self._training, context.processes, files.said)


class PictureRecipe:
    """A network for whole pictures, in rounds."""

    def __init__(self, training: PictureTraining) -> None:
        self._training = training
        self.rounds = training.rounds.count
        self.start = load_start(training.start, PictureNetwork(training.network))
        self.descent, self.stopping = training.descent, training.stopping
        self.error_function = PictureError(training)
        self._teachers = load_teachers(training.teacher)
        self._recordings: Mapping[str, Path] = {}
        self._prepared = Path()

    def preparation(self) -> dict[str, Any]:
        """Size, and what the teacher's maps depend on."""
        network, teacher = self._training.network, self._training.teacher
        return {
            "size": [network.height, network.width],
            "detector": teacher.detector,
            "weights": teacher.weights,
            "views": teacher.views,
            "working": teacher.working.model_dump(),
            "recordings": self._training.recordings.model_dump(include={"separator", "least"}),
        }

    def survey(self, pictures: Sequence[Picture], folder: Path, context: RunContext) -> None:
        """Find the ego cars that recordings show."""
        self._prepared = folder
        self._recordings = find_ego_cars(
            pictures, folder / EGO_CARS, self._training.recordings, context
        )

    def make(self, image: Tensor, name: str) -> Arrays:
        """The picture at the network's size, with the teacher's maps and the ego car."""
        ego = ego_of(self._recordings.get(name), image)
        return prepare_picture(image, ego, self._teachers, self._training)

    def shrink(self, correction: Correction) -> Arrays:
        """What people said, at the network's size."""
        network = self._training.network
        return said_planes(correction, (network.height, network.width))

    def network(self, number: int, last: LayoutNetwork | None) -> PictureNetwork:
        """A new network, or the last one where rounds continue."""
        if isinstance(last, PictureNetwork) and self._training.rounds.start == "continued":
            return last
        with seeded(self._training.random_seed, number):
            return PictureNetwork(self._training.network)

    def samples(
        self, files: PreparedFiles, number: int, last: LayoutNetwork | None, context: RunContext
    ) -> PictureSamples:
        """Varied pictures; from round 2 on with what the last network says of them."""
        labels: list[Path] = []
        if isinstance(last, PictureNetwork):
            folder = context.folder.labels_of(number)
            labels = label_with_network(files.files, folder, last.eval(), context)
        shares, cars = self._footage(files.files)
        corrected = torch.tensor([file in files.said for file in files.files])
        shares = corrected_shares(shares, corrected, self._training.corrections.share)
        prepared = Prepared(files.files, labels, shares, cars, files.said)
        return PictureSamples(prepared, number, self._training, context.processes)

    def _footage(self, files: Sequence[Path]) -> tuple[Tensor, dict[str, list[Path]]]:
        """How often each file is visited, and the files that show an ego car, by recording."""
        settings = self._training.recordings
        pictures = [file.relative_to(self._prepared) for file in files]
        stems = [each.with_suffix("").with_suffix("").as_posix() for each in pictures]
        names = [recording_of(stem, settings.separator) for stem in stems]
        sizes = Counter(names)
        shares = torch.tensor([sizes[name] ** -settings.evenness for name in names])
        cars: dict[str, list[Path]] = {}
        for name, file in zip(names, files, strict=True):
            if lends_ego(file):
                cars.setdefault(name, []).append(file)
        return shares, cars


def load_start(path: str, like: LayoutNetwork) -> LayoutNetwork | None:
    """The network of a weight file, or of a name that is shipped; None for no file.

    One for whole pictures may have learned at another size; it goes on at that of ``like``.
    WeightsError when it is not one ``like`` otherwise.
    """
    if not path:
        return None
    network = load_network(weights_path(path))
    if isinstance(network, PictureNetwork) and isinstance(like, PictureNetwork):
        network = network_at(network, like.settings.height, like.settings.width)
    if network.settings != like.settings:
        what = "holds a network with other settings than this training"
        raise WeightsError(path, what, "give the same [network] settings, or leave start out")
    return network


def recipe_of(training: Training) -> Recipe:
    """The recipe of the kind of network that the settings describe."""
    if isinstance(training, PictureTraining):
        return PictureRecipe(training)
    return PatchRecipe(training)
