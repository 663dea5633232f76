"""Training of whole-image networks: augmented images with their targets. Ours."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.signals import StopRequest
from roadtorch.data.corrections import HumanLabels
from roadtorch.data.events import NOT_ROAD, ROAD_LABEL, VOID_LABEL, layout_layer, road_layer
from roadtorch.evaluation.metrics import ConfusionCounts, count_mask, f_measure
from roadtorch.imaging.resize import resize_maps, spatial_size
from roadtorch.inputs.item import Item
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.layout.image_network import (
    EGO_OUTPUT,
    ROAD_OUTPUT,
    ImageNetwork,
    ImageNetworkSettings,
)
from roadtorch.layout.patch_network import normalise
from roadtorch.layout.weights import LayoutNetwork, WholeImageNetwork
from roadtorch.run.memo import Arrays, cache_key, file_digests, make_cached_reader, read_arrays
from roadtorch.train.augmentation import augment_batch
from roadtorch.train.config import HeadWeights, ImageTraining
from roadtorch.train.prepared import from_uint8, to_uint8
from roadtorch.train.recordings import find_ego_cars, read_ego, recording_name
from roadtorch.train.targets import Targets, best_class, make_targets, split_targets
from roadtorch.train.teachers import (
    label_with_network,
    load_teacher,
    network_maps,
    prepare_image,
    resize_as_prepared,
    shows_ego_car,
)
from roadtorch.train.training_loop import (
    IMAGE_ORDER,
    IMAGE_VARIATION,
    Batch,
    Recipe,
    TrainingInputs,
    make_generator,
    seed_torch,
)

EGO_CARS = "ego-cars"
"""Folder, beside the prepared images, of the ego cars found in recordings."""


# --- samples ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ImageSamples:
    """Prepared images in augmented batches; a chunk is one batch.

    files: prepared images. labels: files of the initial network's maps in the same order, or none.
    sampling_weights: (n,). ego_cars: files that show an ego car, by recording. corrected: file of
    the correction by prepared image.
    """

    training: ImageTraining
    files: Sequence[Path]
    labels: Sequence[Path]
    sampling_weights: Tensor
    ego_cars: Mapping[str, Sequence[Path]]
    corrected: Mapping[Path, Path]
    device: str = "cpu"
    read: Callable[..., Arrays] = field(default_factory=make_cached_reader)

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
        training, seed = self.training, self.training.random_seed
        generator = make_generator(seed, IMAGE_ORDER, 0, epoch)
        order = sample_members(self.sampling_weights, self.count, generator)
        members = order.tensor_split(self.chunks)[chunk].tolist()
        generator = make_generator(seed, IMAGE_VARIATION, 0, epoch, chunk)
        torch.randint(1, (), generator=generator)  # so that a seed gives the weights that it gave
        size = training.network.height, training.network.width
        resize = partial(resize_maps, size=size)
        samples = self._read_samples(members)
        images, planes = augment_batch(
            *samples, training.augmentation, resize, self.ego_cars, generator
        )
        pixels = [normalise(image, training.network.normalisation).pixels for image in images]
        yield Batch(torch.stack(pixels), planes, torch.ones(len(images)))

    def _read_samples(self, members: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Return prepared images (n, 3, H, W) in [0, 1] and their stacked ``Targets``."""
        training, files = self.training, [self.files[member] for member in members]
        images, maps, ego = self._read(files, "image", "maps", "ego")
        network = None
        if self.labels:
            (network,) = self._read([self.labels[member] for member in members], "maps")
        targets = make_targets(maps, ego[:, None], network, training.teacher)
        if self.corrected:
            none = torch.zeros(CORRECTION_PLANES, *spatial_size(images), dtype=torch.uint8)
            planes = [
                self.read(self.corrected[file], "planes")["planes"]
                if file in self.corrected
                else none
                for file in files
            ]
            stacked = from_uint8(torch.stack(planes).to(self.device))
            targets = corrected_targets(targets, stacked, training.corrections.weight)
        return images, torch.cat(targets, 1)

    def _read(self, files: Sequence[Path], *names: str) -> list[Tensor]:
        """Read named arrays of files, stacked, on the device, in [0, 1]."""
        arrays = [self.read(file, *names) for file in files]
        stacks = (torch.stack([entry[name] for entry in arrays]) for name in names)
        return [from_uint8(stack.to(self.device)) for stack in stacks]


def name_recordings(files: Iterable[Path], folder: Path, separator: str) -> list[str]:
    """Return the recording of each prepared image (NAME.SUFFIX.npz) in a folder."""
    stems = [file.relative_to(folder).with_suffix("").with_suffix("") for file in files]
    return [recording_name(stem.as_posix(), separator) for stem in stems]


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


# --- corrections ------------------------------------------------------------------------


CORRECTION_PLANES = 3 + NUM_CLASSES
"""Planes of a correction: road, not road, void and the layout."""

MIN_CORRECTED = 0.5
"""Fraction of a cell's pixels that have to be corrected for the cell to count as corrected."""


def corrected_targets(targets: Targets, planes: Tensor, weight: float) -> Targets:
    """Replace machine targets by corrections, which have the given weight.

    planes: (B, 6, H, W) in [0, 1], of ``ImageRecipe.encode_correction``. Void pixels get the
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


def held_out_f(network: WholeImageNetwork, corrected: Mapping[Path, Path]) -> float:
    """Compute F of a network's road at its own size against corrections, by prepared image.

    0 where nobody labelled road. Raises InputError for a damaged file.
    """
    counts = []
    for file, correction in corrected.items():
        image = from_uint8(read_arrays(file, "image")["image"])
        planes = from_uint8(read_arrays(correction, "planes")["planes"])
        road, not_road = planes[0], planes[1]
        mask = network_maps(network, image)[ROAD_OUTPUT] >= 0.5
        is_labelled = road + not_road >= MIN_CORRECTED
        counts.append(torch.stack(count_mask(mask, road > not_road, is_labelled)))
    return float(f_measure(ConfusionCounts(*torch.stack(counts).sum(0))).nan_to_num())


# --- loss -------------------------------------------------------------------------------


def image_loss(network: nn.Module, batch: Batch, training: ImageTraining) -> Tensor:
    """Sum the mean losses of a batch's images, with soft or hard targets (``Teacher.targets``)."""
    scores = network(batch.inputs).float()
    small = F.adaptive_avg_pool2d(batch.targets, scores.shape[-2:])
    targets = split_targets(small)
    if training.teacher.targets == "hard":
        best = F.one_hot(best_class(targets.layout)[:, 0], NUM_CLASSES).permute(0, 3, 1, 2)
        road = (targets.road >= 0.5).to(targets.road)
        targets = targets._replace(layout=best.to(targets.layout), road=road)
    return target_loss(scores, targets, training.heads)


def target_loss(scores: Tensor, targets: Targets, weights: HeadWeights) -> Tensor:
    """Compute the loss of scores (B, 5, H, W): mean over pixels, summed over images.

    It is the cross-entropy and, with the weight ``dice``, the road's Dice loss (Milletari et al.,
    "V-Net", 3DV 2016).
    """

    def binary(scores: Tensor, targets: Tensor) -> Tensor:
        return F.binary_cross_entropy_with_logits(scores, targets, reduction="none")

    layout = -(targets.layout * scores[:, :NUM_CLASSES].log_softmax(1)).sum(1, keepdim=True)
    road_scores = scores[:, ROAD_OUTPUT : ROAD_OUTPUT + 1]
    road = binary(road_scores, targets.road) * targets.road_weight
    ego = binary(scores[:, EGO_OUTPUT:], targets.ego) * targets.ego_weight
    loss = layout * targets.layout_weight + weights.road * road + weights.ego * ego
    loss = loss.mean((1, 2, 3))
    if weights.dice:
        predicted, true, weight = road_scores.sigmoid(), targets.road, targets.road_weight
        overlap = (predicted * true * weight).sum((1, 2, 3))
        areas = ((predicted.square() + true.square()) * weight).sum((1, 2, 3))
        loss = loss + weights.dice * (1 - 2 * overlap / areas.clamp_min(1e-6))
    return loss.sum()


# --- recipe -----------------------------------------------------------------------------


TEACHER_KEYS = {"detector", "weights", "views", "working"}
"""Settings of a teacher on which its maps depend."""


class ImageRecipe(Recipe):
    """Training of a whole-image network."""

    def __init__(self, training: ImageTraining) -> None:
        super().__init__(training.descent, training.stopping)
        self._training = training
        self.loss = partial(image_loss, training=training)
        self._teacher = load_teacher(training.teacher)
        self._recordings: Mapping[str, Path] = {}
        self._prepared = Path()
        self.preparation = {  # size, and what the teacher's maps depend on
            **(teacher := training.teacher.model_dump(include=TEACHER_KEYS)),
            "files": file_digests(teacher),
            "size": [training.network.height, training.network.width, training.network.upper_rows],
            "recordings": training.recordings.model_dump(include={"separator", "min_frames"}),
        }

    def key(self, image: Item) -> str:
        """Return the cache key of a prepared image; call ``survey`` first."""
        return cache_key(self.preparation, image.path, self._recordings.get(image.name))

    def survey(self, images: Sequence[Item], folder: Path, stop: StopRequest, quiet: bool) -> None:
        """Find the ego cars of the recordings, cached in ``folder``."""
        self._prepared, settings = folder, self._training.recordings
        self._recordings = find_ego_cars(images, folder / EGO_CARS, settings, stop, quiet)

    def prepare(self, image: Tensor, name: str) -> Arrays:
        """Prepare an image at the network's size, with the teacher's maps and the ego car."""
        ego = read_ego(self._recordings.get(name), image)
        return prepare_image(image, ego, self._teacher, self._training)

    def encode_correction(self, correction: HumanLabels) -> Arrays:
        """Return a correction at the network's size: ``planes``, uint8 (6, h, w).

        255 times the fraction of a pixel labelled road, not road, void, sky, vertical, horizontal.
        """
        network = self._training.network
        labels = correction.labels
        road, layout = map(torch.from_numpy, (road_layer(labels), layout_layer(labels)))
        planes = [road == value for value in (ROAD_LABEL, NOT_ROAD, VOID_LABEL)]
        planes += [layout == number for number in range(NUM_CLASSES)]
        stacked, size = torch.stack(planes).to(torch.float32), (network.height, network.width)
        small = resize_as_prepared(stacked, network, size, F.adaptive_avg_pool2d)
        return {"planes": to_uint8(small)}

    def make_network(self, initial: LayoutNetwork | None) -> WholeImageNetwork:
        """Return a new network, or the initial one."""
        settings = self._training.network
        if isinstance(initial, WholeImageNetwork):
            return initial
        assert isinstance(settings, ImageNetworkSettings)  # a backbone needs initial weights
        with seed_torch(self._training.random_seed, 0):
            return ImageNetwork(settings)

    def make_samples(self, inputs: TrainingInputs, stop: StopRequest, quiet: bool) -> ImageSamples:
        """Return augmented images with their targets, and the labels of an initial network."""
        training, files, labels = self._training, inputs.files, list[Path]()
        if isinstance(inputs.initial, WholeImageNetwork):
            network = inputs.initial.eval()
            labels = label_with_network(files, inputs.labels, network, stop, quiet)
        names = name_recordings(files, self._prepared, training.recordings.separator)
        cars = group_ego_cars(files, names)
        weights = torch.tensor(balanced_weights(names, training.recordings.balance))
        corrected = torch.tensor([file in inputs.corrected for file in files])
        weights = reweight(weights, corrected, training.corrections.fraction)
        corrected, device = inputs.corrected, inputs.device
        return ImageSamples(training, files, labels, weights, cars, corrected, device)
