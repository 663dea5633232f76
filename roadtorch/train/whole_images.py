"""Training of whole-image networks: augmented images with their targets. Ours."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.signals import StopRequest
from roadtorch.data.corrections import HumanLabels
from roadtorch.data.events import NOT_ROAD, ROAD_LABEL, VOID_LABEL, layout_layer, road_layer
from roadtorch.evaluation.metrics import ConfusionCounts, count_mask, f_measure
from roadtorch.imaging.resize import resize_maps, spatial_size
from roadtorch.inputs.item import Item
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.layout.network_cues import EGO_OUTPUT, ROAD_OUTPUT
from roadtorch.layout.pretrained import load_imagenet_weights, measure_norms
from roadtorch.run.memo import Arrays, cache_key, make_cached_reader, read_arrays
from roadtorch.train.augmentation import InputResize, augment_batch
from roadtorch.train.config import HeadWeights, ImageTraining, SelfTraining
from roadtorch.train.corrections import scale_learning_rate
from roadtorch.train.prepared import from_uint8, to_uint8
from roadtorch.train.recordings import recording_name
from roadtorch.train.targets import Targets, best_class, make_targets, split_targets
from roadtorch.train.teachers import (
    label_with_network,
    load_teacher,
    network_maps,
    prepare_image,
    resize_as_prepared,
)
from roadtorch.train.training_loop import (
    IMAGE_ORDER,
    IMAGE_VARIATION,
    Batch,
    Recipe,
    TrainingInputs,
    make_generator,
)

# --- samples ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class AugmentedImages(ABC):
    """Whole images in augmented batches; a chunk is one batch.

    files: prepared images. sampling_weights: (n,). ego_cars: files that show an ego car, by
    recording. number: of the round, for the random numbers.
    """

    training: Any
    files: Sequence[Path]
    sampling_weights: Tensor
    ego_cars: Mapping[str, Sequence[Path]]
    number: int = 0
    device: str = "cpu"
    _read: Callable[..., Arrays] = field(default_factory=make_cached_reader)

    @property
    def count(self) -> int:
        """Images of an epoch."""
        return self.training.samples_per_epoch or len(self.files)

    @property
    def chunks(self) -> int:
        """Batches of an epoch."""
        return max(1, round(self.count / self.training.descent.batch))

    def batches(self, epoch: int, chunk: int) -> Iterator[Batch]:
        """Yield the one batch of a chunk; its targets are ``Targets`` stacked to eight planes."""
        training, key = self.training, (self.number, epoch)
        generator = make_generator(training.random_seed, IMAGE_ORDER, *key)
        order = sample_members(self.sampling_weights, self.count, generator)
        members = order.tensor_split(self.chunks)[chunk].tolist()
        generator = make_generator(training.random_seed, IMAGE_VARIATION, *key, chunk)
        resize = self.sample_resize(generator)
        images, planes = self.read_samples(members)
        images, planes = augment_batch(
            images, planes, training.augmentation, resize, self.ego_cars, generator
        )
        images, planes = self.finish(images, planes, members)
        yield Batch(images, planes)

    @abstractmethod
    def sample_resize(self, generator: torch.Generator) -> InputResize:
        """Sample the size of the network's input."""

    @abstractmethod
    def read_samples(self, members: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Return prepared images (n, 3, H, W) in [0, 1] and their stacked ``Targets``."""

    def finish(
        self, images: Tensor, planes: Tensor, members: Sequence[int]
    ) -> tuple[Tensor, Tensor]:
        """Return the network's input and targets of augmented images and planes."""
        return images, planes

    def read(self, file: Path, *names: str) -> Arrays:
        """Read arrays of a file, all or those named, on the device."""
        return {name: value.to(self.device) for name, value in self._read(file, *names).items()}


@dataclass(frozen=True, eq=False)
class ImageSamples(AugmentedImages):
    """Images with the labels of a teacher, and corrections of some of them.

    labels: files of the initial network's maps by prepared image, or none. corrected: prepared
    images with corrections, by the ones without.
    """

    labels: Mapping[Path, Path] = field(default_factory=dict)
    corrected: Mapping[Path, Path] = field(default_factory=dict)

    def sample_resize(self, generator: torch.Generator) -> InputResize:
        """Return the resize to the network's size."""
        torch.randint(1, (), generator=generator)  # so that a seed gives the weights that it gave
        network = self.training.network
        return partial(resize_maps, size=(network.height, network.width))

    def read_samples(self, members: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Return prepared images (n, 3, H, W) in [0, 1] and their stacked ``Targets``."""
        training, files = self.training, [self.files[member] for member in members]
        arrays = [self.read(self.corrected.get(file, file)) for file in files]
        images, maps = (stack_bytes(arrays, name) for name in ("image", "maps"))
        network = None
        if self.labels:
            network = stack_bytes([self.read(self.labels[file], "maps") for file in files], "maps")
        targets = make_targets(maps, network, training.teacher)
        if self.corrected:
            size = CORRECTION_PLANES, *spatial_size(images)
            none = {"planes": torch.zeros(size, dtype=torch.uint8, device=self.device)}
            planes = stack_bytes([none | entry for entry in arrays], "planes")
            targets = corrected_targets(targets, planes, training.corrections.weight)
        return images, torch.cat(targets, 1)


def stack_bytes(arrays: Sequence[Arrays], name: str) -> Tensor:
    """Stack a named array of several images, uint8, to a tensor in [0, 1]."""
    return from_uint8(torch.stack([entry[name] for entry in arrays]))


def name_recordings(files: Iterable[Path], folder: Path, separator: str) -> list[str]:
    """Return the recording of each prepared image (NAME.SUFFIX.npz) in a folder."""
    stems = [file.relative_to(folder).with_suffix("").with_suffix("") for file in files]
    return [recording_name(stem.as_posix(), separator) for stem in stems]


MIN_EGO_WIDTH, MIN_EGO_AREA = 0.95, 0.03
"""Fractions of the columns and of the image that an ego car has to cover to be cut out."""


def shows_ego_car(file: Path) -> bool:
    """Return whether a prepared image shows an ego car from side to side; less may be an error."""
    ego = read_arrays(file, "ego")["ego"] == 255
    across = float(ego.any(0).double().mean())
    return across >= MIN_EGO_WIDTH and float(ego.double().mean()) >= MIN_EGO_AREA


def group_ego_cars(files: Iterable[Path], names: Sequence[str]) -> dict[str, list[Path]]:
    """Group the prepared images that show an ego car by the names of all."""
    cars = dict[str, list[Path]]()
    for file, name in zip(files, names, strict=True):
        if shows_ego_car(file):
            cars.setdefault(name, []).append(file)
    return cars


def balanced_weights(names: Sequence[str], balance: float) -> list[float]:
    """Return sampling weights: n items of one name weigh n^(1 - balance) together."""
    sizes = Counter(names)
    return [sizes[name] ** -balance for name in names]


def sample_members(weights: Tensor, count: int, rng: torch.Generator) -> Tensor:
    """Sample ``count`` indices in proportion to weights (n,), shuffled: int64 (count,).

    Systematic sampling: an index that is expected 1.6 times is sampled once or twice.
    """
    expected = weights.to(torch.float64).cumsum(0)
    expected = expected / expected[-1] * count
    steps = torch.arange(count, dtype=torch.float64) + float(torch.rand((), generator=rng)) * 0.999
    chosen = torch.searchsorted(expected, steps + 5e-4).clamp(max=len(weights) - 1)
    return chosen[torch.randperm(count, generator=rng)]


# --- initial weights ----------------------------------------------------------------------

LEVEL_BATCHES = 30
"""Batches over which the statistics of a new head's features are measured."""


def initialise_network(
    network: nn.Module, samples: AugmentedImages, training: ImageTraining | SelfTraining
) -> None:
    """Load ImageNet's weights, if those, and measure the levels of features.

    A network with other initial weights stays as it is.
    """
    assert isinstance(network, BackboneNetwork)
    if not training.is_new:
        return
    network.to(samples.device)
    count = min(LEVEL_BATCHES, samples.chunks)
    images = (batch.inputs for chunk in range(count) for batch in samples.batches(0, chunk))
    if training.initial_weights:
        load_imagenet_weights(network.backbone)
    measure_norms(network, images)


# --- corrections ------------------------------------------------------------------------


CORRECTION_PLANES = 3 + NUM_CLASSES
"""Planes of a correction: road, not road, void and the layout."""

MIN_CORRECTED = 0.5
"""Fraction of a cell's pixels that have to be corrected for the cell to count as corrected."""


def corrected_targets(targets: Targets, planes: Tensor, weight: float) -> Targets:
    """Replace machine targets by corrections, which have the given weight.

    planes: (B, 6, H, W) in [0, 1], of ``ImageRecipe.correct``. Void pixels get the
    weight 0; corrected road is no ego car.
    """
    road, not_road, void, layout = planes.split((1, 1, 1, NUM_CLASSES), 1)
    is_corrected, is_void = road + not_road >= MIN_CORRECTED, void > MIN_CORRECTED
    road_fraction = road / (road + not_road).clamp_min(1e-6)
    layout_fraction = layout.sum(1, keepdim=True)
    has_layout, is_road = layout_fraction >= MIN_CORRECTED, road >= MIN_CORRECTED

    def weighed(machine: Tensor, where: Tensor) -> Tensor:
        return torch.where(where, weight, machine).masked_fill(is_void, 0)

    return Targets(
        torch.where(has_layout, layout / layout_fraction.clamp_min(1e-6), targets.layout),
        weighed(targets.layout_weight, has_layout),
        torch.where(is_corrected, road_fraction, targets.road),
        weighed(targets.road_weight, is_corrected),
        torch.where(is_road, 0, targets.ego),
        torch.where(is_road, weight, targets.ego_weight),
    )


def reweight(weights: Tensor, chosen: Tensor, fraction: float) -> Tensor:
    """Scale weights (n,) so that chosen images, bool (n,), get ``fraction`` of their sum.

    Unchanged if all images are chosen, or none.
    """
    if not chosen.any() or chosen.all():
        return weights
    chosen_sum, rest_sum = weights[chosen].sum(), weights[~chosen].sum()
    return weights * torch.where(chosen, fraction / chosen_sum, (1 - fraction) / rest_sum)


# --- held-out images --------------------------------------------------------------------


def held_out_f(network: BackboneNetwork, files: Sequence[Path]) -> float:
    """Compute F of a network's road at its own size on prepared images with corrections.

    0 where nobody labelled road. Raises InputError for a damaged file.
    """
    counts = []
    for file in files:
        arrays = read_arrays(file, "image", "planes")
        image, planes = from_uint8(arrays["image"]), from_uint8(arrays["planes"])
        road, not_road = planes[0], planes[1]
        mask = network_maps(network, image)[ROAD_OUTPUT] >= 0.5
        is_labelled = road + not_road >= MIN_CORRECTED
        counts.append(torch.stack(count_mask(mask, road > not_road, is_labelled)))
    return float(f_measure(ConfusionCounts(*torch.stack(counts).sum(0))).nan_to_num())


# --- loss -------------------------------------------------------------------------------


def image_loss(network: nn.Module, batch: Batch, training: ImageTraining) -> Tensor:
    """Sum the losses of a batch's images; targets (B, 8, H, W) are averaged to the scores' size.

    Hard targets (``Teacher.targets``) have one class and road 0 or 1; ego car and weights stay.
    """
    scores = network(batch.inputs).float()
    small = F.adaptive_avg_pool2d(batch.targets, scores.shape[-2:])
    targets = split_targets(small)
    if training.teacher.targets == "hard":
        best = F.one_hot(best_class(targets.layout)[:, 0], NUM_CLASSES).permute(0, 3, 1, 2)
        road = (targets.road >= 0.5).to(targets.road)
        targets = targets._replace(layout=best.to(targets.layout), road=road)
    return target_loss(scores, targets, training.heads)


def target_loss(scores: Tensor, targets: Targets, weights: HeadWeights) -> Tensor:
    """Sum the images' losses of scores (B, 5, H, W): cross-entropy, mean over all pixels."""

    def binary(scores: Tensor, targets: Tensor) -> Tensor:
        return F.binary_cross_entropy_with_logits(scores, targets, reduction="none")

    layout = -(targets.layout * scores[:, :NUM_CLASSES].log_softmax(1)).sum(1, keepdim=True)
    road = binary(scores[:, ROAD_OUTPUT : ROAD_OUTPUT + 1], targets.road) * targets.road_weight
    ego = binary(scores[:, EGO_OUTPUT:], targets.ego) * targets.ego_weight
    loss = layout * targets.layout_weight + weights.road * road + weights.ego * ego
    return loss.mean((1, 2, 3)).sum()


# --- recipe -----------------------------------------------------------------------------


class ImageRecipe(Recipe):
    """Training of a whole-image network."""

    def __init__(self, training: ImageTraining, corrected: int = 0) -> None:
        super().__init__(scale_learning_rate(training, corrected), training.stopping)
        self._training = training
        self.loss = partial(image_loss, training=training)
        self._teacher = load_teacher(training.teacher)
        network = training.network
        size = network.height, network.width, network.upper_rows
        self._preparation = cache_key(self._teacher, size)

    def key(self, image: Item) -> str:
        """Return the cache key of a prepared image."""
        return cache_key(self._preparation, image.path)

    def prepare(self, image: Tensor, name: str) -> Arrays:
        """Prepare an image at the network's size, with the teacher's maps."""
        return prepare_image(image, self._teacher, self._training)

    def correct(self, prepared: Arrays, correction: HumanLabels) -> Arrays:
        """Return a prepared image with a correction: ``planes``, uint8 (6, h, w).

        255 times the fraction of a pixel labelled road, not road, void, sky, vertical, horizontal.
        """
        network = self._training.network
        labels = correction.labels
        road, layout = map(torch.from_numpy, (road_layer(labels), layout_layer(labels)))
        planes = [road == value for value in (ROAD_LABEL, NOT_ROAD, VOID_LABEL)]
        planes += [layout == number for number in range(NUM_CLASSES)]
        stacked, size = torch.stack(planes).to(torch.float32), (network.height, network.width)
        small = resize_as_prepared(stacked, network, size, F.adaptive_avg_pool2d)
        return {**prepared, "planes": to_uint8(small)}

    def initialise(self, network: nn.Module, samples: ImageSamples) -> None:
        """Give a new network its initial weights."""
        initialise_network(network, samples, self._training)

    def make_samples(self, inputs: TrainingInputs, stop: StopRequest, quiet: bool) -> ImageSamples:
        """Return augmented images with their targets, and the labels of an initial network."""
        training, files, labels = self._training, inputs.files, dict[Path, Path]()
        if isinstance(inputs.initial, BackboneNetwork):
            network = inputs.initial.eval()
            labels = label_with_network(files, inputs.labels, network, stop, quiet)
        corrected = torch.tensor([file in inputs.corrected for file in files])
        weights = reweight(torch.ones(len(files)), corrected, training.corrections.fraction)
        maps = {"labels": labels, "corrected": inputs.corrected}
        return ImageSamples(training, files, weights, {}, device=inputs.device, **maps)
