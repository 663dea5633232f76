"""Training of whole-image networks: augmented images with their targets. Ours."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.signals import Stop
from roadtorch.data.corrections import Correction
from roadtorch.data.events import NOT_ROAD, ROAD_SAID, VOID_SAID
from roadtorch.imaging.resize import resized
from roadtorch.inputs.item import Item
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.classes import CLASSES, HORIZONTAL, SKY
from roadtorch.layout.image_network import (
    EGO,
    ROAD,
    ImageNetwork,
    ImageNetworkSettings,
    scaled,
)
from roadtorch.layout.patch_network import normalise
from roadtorch.layout.weights import LayoutNetwork, WholeImageNetwork
from roadtorch.run.memo import Arrays, cached_arrays, file_digests, key_of
from roadtorch.train import augmentation
from roadtorch.train.config import HeadWeights, ImageTraining
from roadtorch.train.loop import (
    IMAGE_ORDER,
    VARIATION,
    Batch,
    TrainingInputs,
    generator_at,
    seeded,
)
from roadtorch.train.prepared import from_bytes, to_bytes
from roadtorch.train.recordings import ego_of, find_ego_cars, recording_of
from roadtorch.train.teachers import (
    PLANES,
    Targets,
    best_class,
    label_with_network,
    lends_ego,
    load_teacher,
    prepare_image,
    targets_of,
)

EGO_CARS = "ego-cars"
"""Folder, beside the prepared images, of the ego cars found in recordings."""


# --- samples ----------------------------------------------------------------------------


@dataclass(frozen=True)
class ImageSamples:
    """Prepared images in augmented batches; a chunk is one batch.

    files: image, teacher's maps and ego car of each. labels: maps of the initial network, in the
    same order, if any. shares: sampling weights. ego_cars: files that show an ego car, by
    recording. corrected: correction by file.
    """

    training: ImageTraining
    files: Sequence[Path]
    labels: Sequence[Path]
    shares: Tensor
    ego_cars: Mapping[str, Sequence[Path]]
    corrected: Mapping[Path, Path]
    read: Callable[..., Arrays] = field(default_factory=cached_arrays)

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
        training = self.training
        generator = generator_at(training.random_seed, IMAGE_ORDER, 0, epoch)
        order = draw_members(self.shares, self.count, generator)
        members = order.tensor_split(self.chunks)[chunk].tolist()
        size = (training.network.height, training.network.width)
        generator = generator_at(training.random_seed, VARIATION, 0, epoch, chunk)
        geometry = training.augmentation.geometry
        frames = augmentation.draw_frames(len(members), size, geometry, generator)
        seeds = torch.randint(2**62, (len(members),), generator=generator).tolist()
        draws = zip(members, frames.split(1), seeds, strict=True)
        images, targets = map(torch.cat, zip(*(self._one(*draw) for draw in draws), strict=True))
        scales = training.scales
        scale = scales[int(torch.randint(len(scales), (), generator=generator))]
        if scale != 1:
            images, targets = (resized(maps, scaled(*size, scale)) for maps in (images, targets))
        yield Batch(images, targets, torch.ones(len(images)))

    def _one(self, member: int, frame: Tensor, seed: int) -> tuple[Tensor, Tensor]:
        """Return an augmented, normalised image (1, 3, H, W) and its targets (1, 8, H, W)."""
        training, at = self.training, torch.Generator().manual_seed(seed)
        vary = training.augmentation
        image, targets = self._unvaried(member)
        image = augmentation.reframed(image, frame, "border")
        planes = augmentation.reframed(torch.cat(targets, 1), frame, "zeros")

        def chosen(share: float) -> bool:
            return float(torch.rand((), generator=at)) < share

        if chosen(vary.surface.share):
            known = Targets(*planes.split(PLANES, 1))
            ground = known.layout[:, HORIZONTAL : HORIZONTAL + 1] * (1 - known.road)
            image = augmentation.resurfaced(image, known.road, ground, vary.surface, at)
        if chosen(vary.shadow.share):
            image = augmentation.shaded(image, vary.shadow, at)
        if self.ego_cars and chosen(vary.ego_car.share):
            car = augmentation.draw_ego_car(self.ego_cars, vary.ego_car, at)
            image, planes = augmentation.laid_over(image, planes, car)
        if chosen(vary.weather.share):
            known = Targets(*planes.split(PLANES, 1))
            sky, ground = (known.layout[:, k : k + 1] for k in (SKY, HORIZONTAL))
            scene = augmentation.Scene(sky, ground, known.road, known.ego * known.ego_weight)
            image = augmentation.in_weather(image, scene, vary.weather, at)
        if chosen(vary.night.share):
            known = Targets(*planes.split(PLANES, 1))
            unlit = (known.layout[:, SKY : SKY + 1] + known.ego).clamp_max(1)
            image = augmentation.at_night(image, unlit, vary.night, at)
        image = augmentation.relit(image, vary.light, at)
        return normalise(image[0], training.network.normalisation).pixels[None], planes

    def _unvaried(self, member: int) -> tuple[Tensor, Targets]:
        """Return a prepared image (1, 3, H, W) in [0, 1] and its targets."""
        training, file, network = self.training, self.files[member], None
        arrays = self.read(file, "image", "maps", "ego")
        image, maps, ego = (from_bytes(arrays[name])[None] for name in ("image", "maps", "ego"))
        if self.labels:
            network = from_bytes(self.read(self.labels[member], "maps")["maps"])[None]
        targets = targets_of(maps, ego[None], network, training.teacher, training.rounds)
        if file in self.corrected:
            planes = from_bytes(self.read(self.corrected[file], "planes")["planes"])[None]
            targets = corrected_targets(targets, planes, training.corrections.weight)
        return image, targets


def draw_members(shares: Tensor, count: int, at: torch.Generator) -> Tensor:
    """Sample ``count`` members in random order, each in proportion to its weight; int64 (count,).

    Systematic sampling: a member whose expected number is 1.6 is sampled once or twice, and with
    equal weights and n samples each is sampled once.
    """
    fair = shares.to(torch.float64).cumsum(0)
    fair = fair / fair[-1] * count
    steps = torch.arange(count, dtype=torch.float64) + float(torch.rand((), generator=at)) * 0.999
    chosen = torch.searchsorted(fair, steps + 5e-4).clamp(max=len(shares) - 1)
    return chosen[torch.randperm(count, generator=at)]


# --- what people said -------------------------------------------------------------------


HALF = 0.5
"""Fraction of a cell's pixels that have to be corrected for the cell to count as corrected."""


def corrected_targets(targets: Targets, planes: Tensor, weight: float) -> Targets:
    """Replace machine targets by corrections.

    planes: (B, 6, H, W) in [0, 1], of ``PictureRecipe.shrink``. Void removes both; corrected road
    is no ego car.
    """
    road, other, void, layout = planes.split((1, 1, 1, CLASSES), 1)
    known, left_out = road + other >= HALF, void > HALF
    share = road / (road + other).clamp_min(1e-6)
    layout_share = layout.sum(1, keepdim=True)
    layout_known, no_ego = layout_share >= HALF, road >= HALF

    def weighed(own: Tensor, where: Tensor) -> Tensor:
        return torch.where(where, weight, own).masked_fill(left_out, 0)

    return Targets(
        torch.where(layout_known, layout / layout_share.clamp_min(1e-6), targets.layout),
        weighed(targets.layout_weight, layout_known),
        torch.where(known, share, targets.road),
        weighed(targets.road_weight, known),
        torch.where(no_ego, 0, targets.ego),
        torch.where(no_ego, weight, targets.ego_weight),
    )


def corrected_shares(shares: Tensor, corrected: Tensor, share: float) -> Tensor:
    """Scale sampling weights (n,) so that corrected images, bool (n,), get ``share`` of the sum.

    Unchanged if all images are corrected, or none.
    """
    if not corrected.any() or corrected.all():
        return shares
    own, others = shares[corrected].sum(), shares[~corrected].sum()
    return torch.where(corrected, shares * (share / own), shares * ((1 - share) / others))


# --- loss -------------------------------------------------------------------------------


def image_loss(network: nn.Module, batch: Batch, training: ImageTraining) -> Tensor:
    """Sum the mean losses of a batch's images; targets are soft, or the best class alone."""
    scores = network(batch.inputs).float()
    small = F.adaptive_avg_pool2d(batch.targets, scores.shape[-2:])
    targets = Targets(*small.split(PLANES, 1))
    if training.teacher.targets == "hard":
        best = F.one_hot(best_class(targets.layout)[:, 0], CLASSES).permute(0, 3, 1, 2)
        road = (targets.road >= 0.5).to(targets.road)
        targets = targets._replace(layout=best.to(targets.layout), road=road)
    return target_loss(scores, targets, training.heads)


def target_loss(scores: Tensor, targets: Targets, weights: HeadWeights) -> Tensor:
    """Compute the cross-entropy of scores (B, 5, H, W): mean over pixels, summed over images."""

    def binary(scores: Tensor, targets: Tensor) -> Tensor:
        return F.binary_cross_entropy_with_logits(scores, targets, reduction="none")

    layout = -(targets.layout * scores[:, :CLASSES].log_softmax(1)).sum(1, keepdim=True)
    road = binary(scores[:, ROAD : ROAD + 1], targets.road) * targets.road_weight
    ego = binary(scores[:, EGO:], targets.ego) * targets.ego_weight
    loss = layout * targets.layout_weight + weights.road * road + weights.ego * ego
    return loss.mean((1, 2, 3)).sum()


# --- a run ------------------------------------------------------------------------------


TEACHER_PARTS = {"detector", "weights", "views", "working"}
"""Settings of a teacher on which its maps depend."""


class ImageRecipe:
    """Training of a whole-image network."""

    def __init__(self, training: ImageTraining) -> None:
        self._training = training
        self.loss = partial(image_loss, training=training)
        self._teacher = load_teacher(training.teacher)
        self._recordings: Mapping[str, Path] = {}
        self._prepared = Path()
        self.preparation = {  # size, and what the teacher's maps depend on
            **(teacher := training.teacher.model_dump(include=TEACHER_PARTS)),
            "files": file_digests(teacher),
            "size": [training.network.height, training.network.width],
            "recordings": training.recordings.model_dump(include={"separator", "least"}),
        }

    def key(self, image: Item) -> str:
        """Return the cache key of a prepared image; call ``survey`` first."""
        return key_of(self.preparation, image.path, self._recordings.get(image.name))

    def survey(self, images: Sequence[Item], folder: Path, stop: Stop, quiet: bool) -> None:
        """Find the ego cars of the recordings, cached in ``folder``."""
        self._prepared, settings = folder, self._training.recordings
        self._recordings = find_ego_cars(images, folder / EGO_CARS, settings, stop, quiet)

    def make(self, image: Tensor, name: str) -> Arrays:
        """Prepare an image at the network's size, with the teacher's maps and the ego car."""
        ego = ego_of(self._recordings.get(name), image)
        return prepare_image(image, ego, self._teacher, self._training)

    def shrink(self, correction: Correction) -> Arrays:
        """Return a correction at the network's size.

        ``planes``: uint8 (6, h, w) in 255ths, fractions of a cell's pixels labelled road, not road,
        void, sky, vertical, horizontal.
        """
        network = self._training.network
        road, layout = torch.from_numpy(correction.road), torch.from_numpy(correction.layout)
        planes = [road == value for value in (ROAD_SAID, NOT_ROAD, VOID_SAID)]
        planes += [layout == number for number in range(CLASSES)]
        stacked = torch.stack(planes).to(torch.float32)
        return {"planes": to_bytes(F.adaptive_avg_pool2d(stacked, (network.height, network.width)))}

    def network(self, start: LayoutNetwork | None) -> WholeImageNetwork:
        """Return a new network, or the initial one."""
        settings = self._training.network
        if isinstance(start, BackboneNetwork):
            return start
        if isinstance(start, ImageNetwork) and self._training.rounds.start == "continued":
            return start
        assert isinstance(settings, ImageNetworkSettings)  # a backbone has weights to start from
        with seeded(self._training.random_seed, 0):
            return ImageNetwork(settings)

    def samples(self, given: TrainingInputs, stop: Stop, quiet: bool) -> ImageSamples:
        """Return augmented images with their targets, and the labels of an initial network."""
        training, files, labels = self._training, given.files, list[Path]()
        if isinstance(given.start, WholeImageNetwork):
            network = given.start.eval()
            labels = label_with_network(files, given.labels, network, stop, quiet)
        names = []
        for file in files:
            stem = file.relative_to(self._prepared).with_suffix("").with_suffix("").as_posix()
            names.append(recording_of(stem, training.recordings.separator))
        sizes, cars = Counter(names), dict[str, list[Path]]()
        for name, file in zip(names, files, strict=True):
            if lends_ego(file):
                cars.setdefault(name, []).append(file)
        shares = torch.tensor([sizes[name] ** -training.recordings.evenness for name in names])
        corrected = torch.tensor([file in given.corrected for file in files])
        shares = corrected_shares(shares, corrected, training.corrections.share)
        return ImageSamples(training, files, labels, shares, cars, given.corrected)
