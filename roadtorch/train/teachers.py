"""Teachers of whole-image networks: their labels. Ours.

The teacher is a detector; its labels may be combined with those of the initial network.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from roadtorch.base.errors import ConfigError
from roadtorch.base.progress import Progress
from roadtorch.base.signals import StopRequest, until_stopped
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detector import Detector
from roadtorch.imaging.resize import resize_maps, spatial_size
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.network_cues import (
    Resize,
    count_upper_rows,
    resize_rows,
    scores_to_potentials,
)
from roadtorch.layout.weights import hash_tensors
from roadtorch.run.loop import Inference
from roadtorch.run.memo import Arrays, cache_key, read_arrays, read_cached, write_cached
from roadtorch.train.config import ImageTraining, Teacher
from roadtorch.train.prepared import from_uint8, to_uint8

# --- teachers ---------------------------------------------------------------------------


def prepare_image(image: Tensor, teacher: Detector, training: ImageTraining) -> Arrays:
    """Return an image (3, H, W) at the network's size, with the teacher's maps, uint8 up to 255.

    Raises ConfigError for a teacher without a layout.
    """
    network, size = training.network, (training.network.height, training.network.width)
    parts = {"image": image, "maps": teacher_maps(image, teacher)}
    small = {name: resize_as_prepared(part, network, size) for name, part in parts.items()}
    return {name: to_uint8(part.clamp(0, 1)) for name, part in small.items()}


def resize_as_prepared(
    maps: Tensor, network: Any, size: tuple[int, int], resize: Resize = resize_maps
) -> Tensor:
    """Resize maps (…, H, W) to a size, with the upper rows of a network of these settings."""
    rows = count_upper_rows(network.upper_rows, network.height)
    return resize_rows(maps, size, round(rows / network.height * size[0]), resize)


def load_teacher(teacher: Teacher) -> Detector:
    """Load the teacher; ConfigError for an unknown name or a detector without a working size."""
    settings: dict[str, Any] = {"weights": {"file": teacher.weights}} if teacher.weights else {}
    settings["working"] = {"pixels": teacher.working.pixels}
    return load_detector(teacher.detector, **settings)


def teacher_maps(image: Tensor, teacher: Detector) -> Tensor:
    """Compute layout and road (4, H, W) in [0, 1] of an image (3, H, W).

    Raises ConfigError for a teacher without a layout.
    """
    detection = Inference(teacher)(image)
    if "layout" not in detection.cues:
        message = f"{teacher.name} has no layout among its cues"
        raise ConfigError("teacher.detector", message, "use fusion or labeller")
    return torch.cat([detection.cues["layout"], detection.likelihood[None]])


def label_with_network(
    files: Sequence[Path], folder: Path, network: BackboneNetwork, stop: StopRequest, quiet: bool
) -> dict[Path, Path]:
    """Write a network's maps of prepared images, averaged over mirroring; return their files.

    Files of the same image and network are reused. If a stop is requested, some are not written.
    """
    weights = hash_tensors(network.state_dict())
    labels = {file: folder / f"{number:06d}.npz" for number, file in enumerate(files)}
    bar = Progress(labels.items(), desc="initial labels", unit="image", quiet=quiet)
    for file, name in until_stopped(bar, stop):
        key = cache_key(weights, file)
        if read_cached(name, key) is None:
            image = from_uint8(read_arrays(file, "image")["image"])
            write_cached(name, key, {"maps": to_uint8(network_maps(network, image))})
    return labels


@torch.no_grad()
def network_maps(network: BackboneNetwork, image: Tensor) -> Tensor:
    """Compute potentials (5, h, w) in [0, 1] of an image (3, h, w), averaged over mirroring."""
    device = next(network.parameters()).device
    scores = network(torch.stack([image, image.flip(-1)]).to(device))
    maps = scores_to_potentials(scores).to(image.device)
    return resize_maps((maps[0] + maps[1].flip(-1)) / 2, spatial_size(image))
