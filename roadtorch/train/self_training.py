"""Self-training: a network learns from rendered worlds, then from real images that it labels. Ours.

The networks of `fusion` and `fusion:scratch` are made so, each in one run. Before each round
but the first the detector with the mean of the rounds' networks labels the target images
(unsupervised domain adaptation by self-training; Zou et al., ECCV 2018; DAFormer, Hoyer et al.,
CVPR 2022), and that mean is what the run writes (Izmailov et al., "Averaging weights leads to wider
optima", UAI 2018).
"""

import copy
import random
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import write_pixels
from roadtorch.base.signals import StopRequest
from roadtorch.detectors.catalogue import load_detector
from roadtorch.imaging.levels import is_at_least
from roadtorch.imaging.resize import resize_maps, spatial_size
from roadtorch.inputs.item import Item, evenly_spaced
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.classes import NUM_CLASSES, VERTICAL
from roadtorch.layout.network_cues import count_upper_rows, resize_rows
from roadtorch.layout.pretrained import IMAGENET, WHEEL
from roadtorch.layout.weights import (
    LayoutNetwork,
    load_network,
    save_network,
    weights_path,
)
from roadtorch.run.memo import Arrays, cache_key, read_arrays
from roadtorch.train.augmentation import InputResize
from roadtorch.train.config import Descent, SelfTraining, Stopping
from roadtorch.train.prepared import Preparation, from_uint8, image_file_name, prepare, to_uint8
from roadtorch.train.run_folder import ROUND_WEIGHTS, SHEET
from roadtorch.train.source import find_source_images, prepare_source, truth_targets
from roadtorch.train.targets import Targets, split_targets
from roadtorch.train.training_loop import Batch, Recipe, TrainingInputs
from roadtorch.train.whole_images import (
    AugmentedImages,
    balanced_weights,
    group_ego_cars,
    initialise_network,
    name_recordings,
    reweight,
    target_loss,
)

SOURCE = "source"
"""Folder, beside the prepared target images, of prepared source images."""

STRIDE = 2
"""Pixels of the network's input for each at which the loss is computed."""

ROUND_DECAY = 0.5
"""Weight of the mean so far in that of the rounds; the averages of two rounds err elsewhere."""

SHEET_TILES, TILE_SIZE = (4, 4), (240, 320)
"""Rows and columns of a sheet of target images with their road, and the size of each."""


# --- labels -----------------------------------------------------------------------------


class SelfTeacher:
    """`fusion:large` with a network: what it is sure of labels target images."""

    def __init__(self, weights: Path) -> None:
        self._detector = load_detector("fusion:large", weights={"file": str(weights)})

    def label(self, image: Tensor) -> Tensor:
        """Return sky, vertical, horizontal, road and not ego car (5, H, W) of an image (3, H, W).

        Where mask and likelihood disagree, as in regions that do not touch the seed area, the road
        is one half, so that it does not count.
        """
        detection = self._detector.detect(image)
        is_road = is_at_least(detection.likelihood, self._detector.settings.threshold)
        road = torch.where(is_road == detection.mask, detection.likelihood, 0.5)
        street = ~detection.cues["ego"]
        return torch.cat([detection.cues["layout"], torch.stack([road * street, street])])

    def compute(self, image: Tensor, name: str, size: tuple[int, int]) -> Arrays:
        """Return the labels of an image as ``maps``, uint8 of a size."""
        return {"maps": to_uint8(resize_maps(self.label(image), size).clamp(0, 1))}


def label_key(image: Item, weights: Path, size: tuple[int, int]) -> str:
    """Return the cache key of the labels of an image; a worker gets this function by its name."""
    return cache_key(weights, size, image.path)


def label_targets(maps: Tensor, training: SelfTraining) -> Targets:
    """Return the targets of labels (n, 5, H, W) in [0, 1] of ``SelfTeacher``; of no ego car."""
    layout, road, street = maps.split([NUM_CLASSES, 1, 1], 1)
    settings, best = training.target, layout.topk(2, 1).values
    is_clear = (best[:, :1] - best[:, 1:] >= settings.margin) & (street > 0.5)
    weight = ((2 * road - 1).abs() >= settings.road_margin).to(road)
    none = torch.zeros_like(road)
    return Targets(layout, is_clear.to(road), road, weight, none, none)


# --- samples ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DomainSamples(AugmentedImages):
    """Source and then target images of a round; targets have the size of the loss.

    labels: file of the labels by prepared target image.
    """

    labels: Mapping[Path, Path] = field(default_factory=dict)

    def sample_resize(self, generator: torch.Generator) -> InputResize:
        """Sample the size and the upper rows of the network's input."""
        choice = random.Random(int(torch.randint(2**62, (), generator=generator)))
        size = choice.choice(self.training.sizes)
        rows = count_upper_rows(choice.choice(self.training.upper_rows), size[0])
        return partial(resize_rows, size=size, rows=rows)

    def read_samples(self, members: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Return prepared images (n, 3, H, W) in [0, 1] and their stacked ``Targets``."""
        images, planes = list[Tensor](), list[Tensor]()
        for file in (self.files[member] for member in members):
            arrays = self.read(file)
            images.append(from_uint8(arrays["image"]))
            if file in self.labels:
                maps = from_uint8(self.read(self.labels[file], "maps")["maps"])
                fine = F.interpolate(maps[None], spatial_size(images[-1]), mode="bilinear")
                targets = label_targets(fine, self.training)
            else:
                codes, ego = (arrays[name][None, None] for name in ("codes", "ego"))
                targets = truth_targets(codes, from_uint8(ego))
            planes.append(torch.cat(targets, 1))
        return torch.stack(images), torch.cat(planes)

    def finish(
        self, images: Tensor, planes: Tensor, members: Sequence[int]
    ) -> tuple[Tensor, Tensor]:
        """Reduce planes to the size of the loss, and weigh borders of road: ``weigh_borders``."""
        planes, border = F.avg_pool2d(planes, STRIDE), self.training.source.border
        if border:
            is_exact = [self.files[member] not in self.labels for member in members]
            planes = weigh_borders(planes, torch.tensor(is_exact, device=planes.device), border)
        return images.contiguous(memory_format=torch.channels_last), planes


def weigh_borders(planes: Tensor, is_exact: Tensor, border: float) -> Tensor:
    """Weigh road and layout of stacked ``Targets`` (n, 8, H, W) where road meets the vertical.

    is_exact: bool (n,), whether the truth is a renderer's: there ``border`` is added to a weight of
    1. Machine labels are uncertain there, and get the weight 0.
    """
    targets = split_targets(planes)
    vertical = targets.layout[:, VERTICAL : VERTICAL + 1] * targets.layout_weight
    near_road, near_vertical = (F.max_pool2d(mask, 3, 1, 1) for mask in (targets.road, vertical))
    added = torch.where(is_exact, border, -1.0)[:, None, None, None]
    gain = (1 + near_road * near_vertical * added).clamp_min(0)
    layout_weight, road_weight = (
        weight * gain for weight in (targets.layout_weight, targets.road_weight)
    )
    return torch.cat(targets._replace(layout_weight=layout_weight, road_weight=road_weight), 1)


# --- recipe -----------------------------------------------------------------------------


class SelfTrainingRecipe(Recipe):
    """Training on source and target images, in rounds."""

    def __init__(self, training: SelfTraining, source: Sequence[Path]) -> None:
        super().__init__(training.descent, Stopping(rule="epochs"))
        if not source:
            raise ConfigError("--source", "is missing", "give folders of rendered worlds")
        self._training, self.rounds = training, len(training.rounds)
        self.source = find_source_images(source)
        self._truth = {image.item.name: image for image in self.source}
        self._prepared = Path()
        self._images = dict[str, Item]()
        self._kinds = dict[Path, str]()
        self._files: Sequence[Path] = ()
        sides = zip(*training.sizes, strict=True)
        height, width = (max(side) for side in sides)
        self._size = 9 * height // 8, 6 * width // 5  # room for what augmentation enlarges

    # --- preparation ------------------------------------------------------------------------

    def key(self, image: Item) -> str:
        """Return the cache key of a prepared target image."""
        return cache_key("target", self._size, image.path)

    def survey(self, images: Sequence[Item], folder: Path, stop: StopRequest, quiet: bool) -> None:
        """Prepare the source images in a folder inside ``folder``."""
        self._prepared, self._images = folder, {image_file_name(image): image for image in images}
        preparation = Preparation(folder / SOURCE, self._source_key, self._prepare_source)
        items = [image.item for image in self.source]
        prepared = prepare(items, preparation, stop, quiet, "source")
        named = zip(self.source, prepared, strict=False)  # fewer where a stop was requested
        self._kinds = {item.file: image.kind for image, item in named if item.file}
        if not self._kinds and not stop.requested:
            raise InputError("--source", "holds no usable image", "see the messages above")

    def _source_key(self, item: Item) -> str:
        return cache_key("source", self._size, *self._truth[item.name].files)

    def _prepare_source(self, image: Tensor, name: str) -> Arrays:
        return prepare_source(image, self._truth[name], self._size)

    def prepare(self, image: Tensor, name: str) -> Arrays:
        """Prepare a target image: ``image`` alone, its labels are those of a round."""
        return {"image": to_uint8(resize_maps(image, self._size).clamp(0, 1))}

    # --- network ----------------------------------------------------------------------------

    def initialise(self, network: nn.Module, samples: DomainSamples) -> None:
        """Give a new network its initial weights."""
        initialise_network(network, samples, self._training)

    # --- rounds -----------------------------------------------------------------------------

    def rules(self, number: int) -> tuple[Descent, Stopping]:
        """Return the descent and the end of a round."""
        settings, (descent, stopping) = self._training.rounds[number - 1], super().rules(number)
        if settings.learning_rate:
            descent = descent.model_copy(update={"learning_rate": settings.learning_rate})
        return descent, stopping.model_copy(update={"epochs": settings.epochs})

    def parameter_groups(self, network: nn.Module, number: int) -> list[dict[str, Any]]:
        """Return head and backbone; what is frozen needs no gradients."""
        training, factor = self._training, self._training.rounds[number - 1].backbone_factor
        assert isinstance(network, BackboneNetwork)
        backbone = network.backbone
        backbone.requires_grad_(bool(factor))
        if training.frozen_blocks:
            for part in (backbone.stem, *backbone.blocks[: training.frozen_blocks]):
                part.requires_grad_(False)
        groups = [{"params": list(network.head.parameters()), "factor": 1.0}]
        learning = [weight for weight in backbone.parameters() if weight.requires_grad]
        return groups + ([{"params": learning, "factor": factor}] if learning else [])

    def loss(self, network: nn.Module, batch: Batch) -> Tensor:
        """Sum the mean losses of a batch's images."""
        inputs = batch.inputs.contiguous(memory_format=torch.channels_last)  # a third faster
        scores = network(inputs).float()
        scores = F.interpolate(scores, spatial_size(batch.targets), mode="bilinear")
        return target_loss(scores, split_targets(batch.targets), self._training.heads)

    def make_samples(self, inputs: TrainingInputs, stop: StopRequest, quiet: bool) -> DomainSamples:
        """Return the samples of a round; label the target images if it has some."""
        training, source, labels = self._training, list(self._kinds), dict[Path, Path]()
        self._files = inputs.files
        fraction = training.rounds[inputs.number - 1].target
        if fraction:
            labels = self._label(inputs, stop, quiet)
        kinds = list(self._kinds.values())
        recordings = name_recordings(labels, self._prepared, training.target.separator)
        weights = [
            *balanced_weights(kinds, training.source.balance),
            *balanced_weights(recordings, training.target.balance),
        ]
        is_target = torch.arange(len(weights)) >= len(source)
        cars = group_ego_cars(source, kinds)
        chances = reweight(torch.tensor(weights), is_target, fraction)
        common = ([*source, *labels], chances, cars, inputs.number, inputs.device)
        effects = training.rounds[inputs.number - 1].effects
        changes = {"augmentation": training.augmentation.scale_effects(effects)}
        return DomainSamples(training.model_copy(update=changes), *common, labels=labels)

    def _label(self, inputs: TrainingInputs, stop: StopRequest, quiet: bool) -> dict[Path, Path]:
        """Label the target images with the mean of the rounds before; return files of labels."""
        training = self._training
        weights = (
            round_weights(inputs.out, inputs.number - 1)
            if inputs.number > 1
            else weights_path(training.initial_weights)
        )
        teacher = SelfTeacher(weights)
        size = self._size[0] // STRIDE, self._size[1] // STRIDE
        prepared = self._prepared
        files = {
            file.relative_to(prepared).with_suffix("").as_posix(): file for file in inputs.files
        }
        items = [self._images[name] for name in files]
        key = partial(label_key, weights=weights, size=size)
        preparation = Preparation(inputs.labels, key, partial(teacher.compute, size=size))
        prepared_items = prepare(items, preparation, stop, quiet)
        labelled = {files[item.name]: item.file for item in prepared_items if item.file}
        if not labelled and not stop.requested:
            raise InputError("--images", "holds no image that could be labelled", "see above")
        return labelled

    def finish_round(self, network: LayoutNetwork, out: Path, number: int) -> LayoutNetwork:
        """Write the exponential mean of the rounds whose backbone learned; return it.

        Before the second it is the network. Writes also a sheet of target images with its road.
        """
        path, sheet = round_weights(out, number), out / SHEET.format(number)
        if not sheet.exists():  # else of an interrupted run
            mean, earlier = copy.deepcopy(network), self._training.rounds[: number - 1]
            if any(entry.backbone_factor for entry in earlier):
                previous = load_network(round_weights(out, number - 1)).state_dict()
                for name, weight in mean.state_dict().items():
                    if weight.is_floating_point():
                        weight.lerp_(previous[name].to(weight), ROUND_DECAY)
            save_network(path, mean, {"round": number})
            self._write_sheet(sheet, path)
        return load_network(path)

    def _write_sheet(self, sheet: Path, weights: Path) -> None:
        """Write target images with the road that `fusion` finds by a weight file."""
        detector = load_detector("fusion", weights={"file": str(weights)})
        rows, columns = SHEET_TILES
        tiles = list[np.ndarray]()
        for file in evenly_spaced(self._files, rows * columns)[: rows * columns]:
            image = resize_maps(from_uint8(read_arrays(file, "image")["image"]), TILE_SIZE)
            tiles.append(detector.detect(image).overlay())
        tiles += [np.zeros_like(tiles[0])] * (rows * columns - len(tiles))
        lines = [np.hstack(tiles[k : k + columns]) for k in range(0, len(tiles), columns)]
        write_pixels(sheet, np.vstack(lines))

    # --- card -------------------------------------------------------------------------------

    def format_card(self, origin: Mapping[str, object], command: str) -> str:
        """Format the card beside the weights of a run."""
        training = self._training
        weights = training.initial_weights or "random weights"
        if weights == IMAGENET:
            weights = f"ImageNet's object labels, package `{WHEEL}` (Apache-2.0)"
        kinds = Counter(self._kinds.values())
        targets = [file.relative_to(self._prepared).as_posix() for file in self._files]
        source = [file.relative_to(self._prepared).as_posix() for file in self._kinds]
        counts = ", ".join(f"{kind} {count}" for kind, count in sorted(kinds.items()))
        rows = {
            "backbone": f"EfficientNet-Lite0, from {weights}",
            "source": f"{len(source)} images with a renderer's truth ({counts})",
            "source's names": f"SHA-256 {names_digest(source)}",
            "target": f"{len(targets)} images, labelled by the run's own network",
            "target's names": f"SHA-256 {names_digest(targets)}",
            "command": f"`{command}`" if command else "",
            "seed": str(training.random_seed),
            "config": f"SHA-256 {origin['config_sha256']}, roadtorch {origin['roadtorch']}",
            "human road labels": "see above" if origin["corrections"] else "none",
            "terms": "not stated yet: those of the images above apply",
        }
        lines = ["# A network of one self-training run", "", "| | |", "|---|---|"]
        return "\n".join([*lines, *(f"| {key} | {row} |" for key, row in rows.items()), ""])


def round_weights(out: Path, number: int) -> Path:
    """Return the path of the weights after a round."""
    return out / ROUND_WEIGHTS.format(number)


def names_digest(names: Sequence[str]) -> str:
    """Return the SHA-256 of a list of names, sorted, one a line."""
    return sha256("".join(f"{name}\n" for name in sorted(names)).encode()).hexdigest()
