"""Teachers of whole-image networks: their labels, the targets made of them, agreement. Ours.

The teacher is a detector; its labels may be combined with those of the initial network.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from roadtorch.base.errors import ConfigError
from roadtorch.base.progress import Progress
from roadtorch.base.signals import StopRequest, until_stopped
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detector import Detector
from roadtorch.evaluation.disagreement import Agreement
from roadtorch.imaging.resize import resize_maps, spatial_size
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.layout.image_network import (
    ROAD_OUTPUT,
    Resize,
    count_upper_rows,
    resize_rows,
    scores_to_potentials,
)
from roadtorch.layout.patch_network import normalise
from roadtorch.layout.weights import WholeImageNetwork
from roadtorch.road.bayes import centred_odds, log_odds
from roadtorch.road.ego import extrapolate_over_ego
from roadtorch.run.loop import Inference
from roadtorch.run.memo import Arrays, cache_key, read_arrays, read_cached, write_cached
from roadtorch.train.config import ImageTraining, Teacher
from roadtorch.train.prepared import from_uint8, to_uint8

# --- targets ----------------------------------------------------------------------------


EGO_KNOWN = 0.25
"""Least distance of an ego value from 0.5, unknown, to count: values are interpolated by warps."""

EGO_CERTAIN = 0.8
"""Probability from which a network's ego car counts, so that errors do not grow from run to run."""


class Targets(NamedTuple):
    """Targets of a network and their weights, in [0, 1].

    layout: (B, 3, H, W); layout_weight, road, road_weight, ego, ego_weight: (B, 1, H, W).
    """

    layout: Tensor
    layout_weight: Tensor
    road: Tensor
    road_weight: Tensor
    ego: Tensor
    ego_weight: Tensor


TARGET_PLANES = (NUM_CLASSES, 1, 1, 1, 1, 1)
"""Planes of the fields of ``Targets``."""


def make_targets(
    teacher: Tensor, ego: Tensor, network: Tensor | None, settings: Teacher
) -> Targets:
    """Compute targets from the maps (B, 4, H, W) of the teacher and (B, 5, H, W) of a network.

    ego: ego car in the footage, (B, 1, H, W): 1 ego, 0 not, 0.5 unknown; there it is 1 where the
    network is certain of one, else 0. Road likelihoods are shifted so that their threshold becomes
    0.5. Weights are 0 or 1: 1 where the best class leads by ``margin``, road is certain by
    ``road_margin``, and, with ``combine = "agreement"``, teacher and network agree. On the ego car
    road is 0 with weight 1, and the layout has weight 0.
    """
    layout, road = teacher[:, :NUM_CLASSES], centre_likelihood(teacher[:, NUM_CLASSES:], settings)
    agree, agree_road, guess = torch.ones_like(road), torch.ones_like(road), torch.zeros_like(ego)
    if network is not None:
        network_layout, network_road, network_ego = network.split((NUM_CLASSES, 1, 1), 1)
        guess = (network_ego >= EGO_CERTAIN).to(ego)
        if settings.combine == "agreement":
            agree = (best_class(layout) == best_class(network_layout)).to(road)
            agree_road = ((road >= 0.5) == (network_road >= 0.5)).to(road)
        weight = 1.0 if settings.combine == "teacher" else 0.5
        layout = torch.lerp(network_layout, layout, weight)
        road = torch.lerp(network_road, road, weight)
    ego = torch.where((ego - 0.5).abs() < EGO_KNOWN, guess, ego)
    best = layout.topk(2, dim=1).values
    sure = (best[:, :1] - best[:, 1:] >= settings.margin).to(road)
    sure_road = ((2 * road - 1).abs() >= settings.road_margin).to(road)
    sure_ego = ((2 * ego - 1).abs() >= EGO_KNOWN).to(road)
    street = (ego < 0.5 + EGO_KNOWN).to(road)
    known_road = torch.maximum(sure_road * agree_road, 1 - street)
    return Targets(layout, sure * agree * street, road * street, known_road, ego, sure_ego)


def best_class(layout: Tensor) -> Tensor:
    """Return the index int64 (B, 1, H, W) of the largest potential (B, 3, H, W).

    ``argmax`` is ten times slower where the classes are not the last dimension.
    """
    return layout.max(1, keepdim=True).indices


def centre_likelihood(likelihood: Tensor, settings: Teacher) -> Tensor:
    """Shift likelihoods (B, 1, H, W) so that the threshold of road becomes 0.5."""
    centre = math.log(settings.road_threshold / (1 - settings.road_threshold))
    centred = [centred_odds(odds, centre, settings.otsu_weight) for odds in log_odds(likelihood)]
    return torch.stack(centred).sigmoid()


# --- teachers ---------------------------------------------------------------------------


MIN_EGO_WIDTH, MIN_EGO_AREA = 0.95, 0.03
"""Fractions of the columns and of the image that an ego car has to cover to be cut out."""


def prepare_image(
    image: Tensor, ego: Tensor | None, teacher: Detector, training: ImageTraining
) -> Arrays:
    """Return an image (3, H, W) at the network's size, with the teacher's maps and the ego car.

    ego: bool (H, W), ego car found in the footage, over which the ground is extrapolated before the
    teacher sees it; None if unknown. Raises ConfigError for a teacher without a layout.
    """
    network, size = training.network, (training.network.height, training.network.width)
    street = image if ego is None else extrapolate_over_ego(image, ego)
    maps = teacher_maps(street, teacher, training.teacher.views)
    car = torch.full(size, 0.5) if ego is None else ego.float()
    image, maps, car = (resize_as_prepared(part, network, size) for part in (image, maps, car))
    return encode_maps(image, maps, car, size)


def resize_as_prepared(
    maps: Tensor, network: Any, size: tuple[int, int], resize: Resize = resize_maps
) -> Tensor:
    """Resize maps (…, H, W) to a size, with the upper rows of a network of these settings."""
    rows = count_upper_rows(network.upper_rows, network.height)
    return resize_rows(maps, size, round(rows / network.height * size[0]), resize)


def encode_maps(image: Tensor, maps: Tensor, ego: Tensor, size: tuple[int, int]) -> Arrays:
    """Resize an image (3, h, w) and its maps, in [0, 1] and of any sizes, to uint8 up to 255.

    maps: the teacher's sky, vertical, horizontal, road, (4, h, w). ego: (h, w), 1 ego, 0 not, 0.5
    unknown.
    """
    parts = {"image": image, "maps": maps, "ego": ego[None]}
    small = {name: to_uint8(resize_maps(part, size).clamp(0, 1)) for name, part in parts.items()}
    return {**small, "ego": small["ego"][0]}


def shows_ego_car(file: Path) -> bool:
    """Return whether a prepared image shows an ego car from side to side; less may be an error."""
    ego = read_arrays(file, "ego")["ego"] == 255
    across = float(ego.any(0).double().mean())
    return across >= MIN_EGO_WIDTH and float(ego.double().mean()) >= MIN_EGO_AREA


def load_teacher(teacher: Teacher) -> Detector:
    """Load the teacher; ConfigError for an unknown name or a detector without a working size."""
    settings: dict[str, Any] = {"weights": {"file": teacher.weights}} if teacher.weights else {}
    settings["working"] = {"pixels": teacher.working.pixels}
    return load_detector(teacher.detector, runtime=teacher.runtime, **settings)


def teacher_maps(image: Tensor, teacher: Detector, views: str = "one") -> Tensor:
    """Compute layout and road (4, H, W) in [0, 1] of an image (3, H, W).

    views: as in ``Teacher``. Raises ConfigError for a teacher without a layout.
    """
    maps = []
    for mirrored in (False,) if views == "one" else (False, True):
        detection = Inference(teacher)(image.flip(-1) if mirrored else image)
        if "layout" not in detection.cues:
            message = f"{teacher.name} has no layout among its cues"
            raise ConfigError("teacher.detector", message, "use fusion or labeller")
        planes = torch.cat([detection.cues["layout"], detection.likelihood[None]])
        maps.append(planes.flip(-1) if mirrored else planes)
    return torch.stack(maps).mean(0)


def label_with_network(
    files: Sequence[Path], folder: Path, network: WholeImageNetwork, stop: StopRequest, quiet: bool
) -> list[Path]:
    """Write a network's maps of prepared images, averaged over mirroring; return the files.

    Files of the same image and network are reused. If a stop is requested, some are not written.
    """
    weights = cache_key([value.numpy().tobytes() for value in network.state_dict().values()])
    names = [folder / f"{number:06d}.npz" for number in range(len(files))]
    pairs = list(zip(files, names, strict=True))
    bar = Progress(pairs, desc="initial labels", unit="image", quiet=quiet)
    for file, name in until_stopped(bar, stop):
        key = cache_key(weights, file)
        if read_cached(name, key) is None:
            image = from_uint8(read_arrays(file, "image")["image"])
            write_cached(name, key, {"maps": to_uint8(network_maps(network, image))})
    return names


@torch.no_grad()
def network_maps(network: WholeImageNetwork, image: Tensor) -> Tensor:
    """Compute potentials (5, h, w) in [0, 1] of an image (3, h, w), averaged over mirroring."""
    pixels = normalise(image, network.settings.normalisation).pixels
    device = next(network.parameters()).device
    scores = network(torch.stack([pixels, pixels.flip(-1)]).to(device))
    maps = scores_to_potentials(scores).to(image.device)
    return resize_maps((maps[0] + maps[1].flip(-1)) / 2, spatial_size(image))


# --- agreement --------------------------------------------------------------------------


def teacher_agreement(
    network: WholeImageNetwork, files: Sequence[Path], training: ImageTraining
) -> Agreement:
    """Measure the fractions of pixels of prepared images on which network and teacher agree.

    Only pixels with a weight in ``make_targets`` count; without any, a fraction is NaN. Raises
    InputError for a damaged file.
    """
    agreeing, counted = torch.zeros(2, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    for file in files:
        arrays = read_arrays(file, "image", "maps", "ego")
        image, maps, ego = (from_uint8(arrays[name]) for name in ("image", "maps", "ego"))
        targets = make_targets(maps[None], ego[None, None], None, training.teacher)
        potentials = network_maps(network, image)[None]
        layout = potentials[:, :NUM_CLASSES].argmax(1) == targets.layout.argmax(1)
        road = (potentials[:, ROAD_OUTPUT] >= 0.5) == (targets.road[:, 0] >= 0.5)
        where = torch.stack([targets.layout_weight[:, 0], targets.road_weight[:, 0]]) > 0
        agreeing += (torch.stack([layout, road]) & where).flatten(1).sum(1)
        counted += where.flatten(1).sum(1)
    ratios = agreeing / counted
    return Agreement(float(ratios[0]), float(ratios[1]), len(files))
